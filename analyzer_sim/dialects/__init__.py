"""What each maker's analyzer understands and answers, as tables of commands.

Public: dialect, dialects.
"""
