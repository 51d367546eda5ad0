"""Oracle of a campaign: the linear filter that knows true statistics, and what it knows of measured motion."""
