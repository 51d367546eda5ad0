"""Release of torques: the interlock and the life of a command as tables, and the one function that steps them.

Public: advance, command_states, command_transitions, control_verdict, events, interlock, interlock_conditions,
interlock_states, proposals, release_checks, settings, sign_checks, state_document.
"""
