"""The dialects the simulator speaks, by the name given on the command line."""

from analyzer_sim.dialect import Dialect
from analyzer_sim.dialect_rs import RS

DIALECTS: dict[str, Dialect] = {dialect.name: dialect for dialect in (RS,)}
