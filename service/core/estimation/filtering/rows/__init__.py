"""A row of the attitude filter after its prediction: its stages, compiled or one by one."""
