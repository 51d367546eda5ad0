"""The dialects the simulator speaks, by the name given on the command line."""

from analyzer_sim.dialects.anritsu import ANRITSU
from analyzer_sim.dialects.dialect import Dialect
from analyzer_sim.dialects.keysight import KEYSIGHT
from analyzer_sim.dialects.rs import RS
from analyzer_sim.dialects.siglent import SIGLENT

DIALECTS: dict[str, Dialect] = {dialect.name: dialect for dialect in (RS, KEYSIGHT, SIGLENT, ANRITSU)}
