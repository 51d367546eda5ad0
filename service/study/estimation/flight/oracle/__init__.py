"""Oracle of a campaign: the linear filter that knows true statistics, and what it knows of measured motion."""

from service.study.estimation.flight.oracle.filter import ORACLE, oracle_series

__all__ = ["ORACLE", "oracle_series"]
