"""Model and state of the attitude filter, and the priors of what it cannot see."""
