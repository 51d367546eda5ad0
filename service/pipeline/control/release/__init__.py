"""Release of torques: the interlock and the life of a command as tables, and the one function that steps them."""
