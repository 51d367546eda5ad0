"""Commands and dialogues that bring an operator's own data to the service."""
