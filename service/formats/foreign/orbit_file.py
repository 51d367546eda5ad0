"""Files of orbits as they come: two-line elements with or without a name, OMM in four notations, OEM.

Mean elements of an OMM become two-line elements by sgp4's own reader and writer, which carry what SGP4 uses.
"""

import io
import json
import re
from collections.abc import Mapping
from typing import Any, NamedTuple
from xml.etree.ElementTree import ParseError

from sgp4 import exporter, omm
from sgp4.api import Satrec

from service.formats.foreign.layout import ForeignTableError

#: members of an OMM that a provider may leave out, with what SGP4 takes for them
_OPTIONAL = {
    "CLASSIFICATION_TYPE": "U",
    "EPHEMERIS_TYPE": "0",
    "ELEMENT_SET_NO": "999",
    "REV_AT_EPOCH": "0",
    "MEAN_MOTION_DDOT": "0",
    "MEAN_MOTION_DOT": "0",
}
#: members that would make other elements of the same numbers
_REQUIRED_VALUES = {
    "MEAN_ELEMENT_THEORY": ("SGP4", "SGP/SGP4"),
    "CENTER_NAME": ("EARTH",),
    "REF_FRAME": ("TEME",),
    "TIME_SYSTEM": ("UTC",),
}
_PAIR = re.compile(r"\s*([A-Z][A-Z0-9_]*)\s*=\s*(.*?)\s*(?:\[[^\]]*\])?\s*")
_DESIGNATOR = re.compile(r"(\d{2})(\d{3})([A-Z]{1,3})")
#: of years in two-line elements
_CENTURY_TURNS = 57


class OrbitFile(NamedTuple):
    """An orbit in the form of the interface."""

    #: TLE, OMM, OEM, or interface document
    form: str
    name: str | None
    #: international designator YYYY-NNNP
    cospar_id: str | None
    #: body of ``PUT .../ephemeris``
    body: dict[str, Any]


def read_orbit_file(text: str) -> OrbitFile:
    """Return the orbit of a file.

    Parameters
    ----------
    text : str
        Two-line elements, an OMM (JSON, XML, keyword = value, CSV), an OEM, or a document of the interface.

    Raises
    ------
    ForeignTableError
        None of these, elements of several objects, or an OMM of another theory, centre, frame or time system.
    """
    content = text.removeprefix("\ufeff").strip()
    if content.startswith("CCSDS_OEM_VERS"):
        return OrbitFile("OEM", _oem_value(content, "OBJECT_NAME"), _oem_value(content, "OBJECT_ID"), {"oem": content})
    if content.startswith(("{", "[")):
        return _from_json(content)
    if content.startswith("<"):
        return _of_omm(_single(_xml_fields(content)))
    if content.startswith("CCSDS_OMM_VERS"):
        pairs = (_PAIR.fullmatch(line) for line in content.splitlines())
        return _of_omm({pair.group(1): pair.group(2) for pair in pairs if pair is not None})
    if "MEAN_MOTION" in content.partition("\n")[0]:
        return _of_omm(_single(list(omm.parse_csv(io.StringIO(content)))))
    return _from_lines([line.rstrip() for line in content.splitlines() if line.strip()])


def _from_json(content: str) -> OrbitFile:
    """Return the orbit of JSON: an OMM or a list with one, or a document of the interface."""
    try:
        document = json.loads(content)
    except ValueError as error:
        raise ForeignTableError(f"the file is no JSON: {error}") from None
    entries = document if isinstance(document, list) else [document]
    if not entries or not all(isinstance(each, dict) for each in entries):
        raise ForeignTableError("the file holds no JSON object with an orbit")
    if "MEAN_MOTION" in entries[0]:
        return _of_omm(_single(entries))
    body: dict[str, Any] = _single(entries)
    lines = body.get("tle")
    is_elements = isinstance(lines, list) and len(lines) == 2 and isinstance(lines[0], str)
    return OrbitFile("interface document", None, _designator(lines[0]) if is_elements and lines else None, body)


def _single(entries: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the only entry of a file."""
    if len(entries) != 1:
        names = ", ".join(str(each.get("OBJECT_NAME", "?")) for each in entries[:5])
        raise ForeignTableError(f"the file holds {len(entries)} objects ({names}); keep the one of this spacecraft")
    return entries[0]


def _xml_fields(content: str) -> list[dict[str, Any]]:
    """Return the members of each segment of an XML message."""
    if "<!DOCTYPE" in content or "<!ENTITY" in content:
        raise ForeignTableError("an XML message has no document type; remove it")
    try:
        return list(omm.parse_xml(io.StringIO(content)))
    except (ParseError, AttributeError, TypeError) as error:
        raise ForeignTableError(f"the file is no OMM in XML: {error}") from None


def _of_omm(fields: Mapping[str, Any]) -> OrbitFile:
    """Return two-line elements of mean elements."""
    stated = {name: str(value).strip() for name, value in fields.items() if value not in (None, "")}
    for name, understood in _REQUIRED_VALUES.items():
        if name in stated and stated[name].upper() not in understood:
            raise ForeignTableError(f"{name} = {stated[name][:40]}; understood: {', '.join(understood)}")
    epoch, _, fraction = stated.get("EPOCH", "").removesuffix("Z").partition(".")
    stated["EPOCH"] = f"{epoch}.{(fraction or '0')[:6]}"
    satellite = Satrec()
    try:
        omm.initialize(satellite, {**_OPTIONAL, **stated})
        first, second = exporter.export_tle(satellite)
    except KeyError as error:
        raise ForeignTableError(f"the OMM has no {error.args[0]}") from None
    except (ValueError, OverflowError) as error:
        raise ForeignTableError(f"the OMM holds a member that is no number or epoch: {error}") from None
    return OrbitFile("OMM", stated.get("OBJECT_NAME"), stated.get("OBJECT_ID"), {"tle": [first, second]})


def _from_lines(lines: list[str]) -> OrbitFile:
    """Return the orbit of two-line elements, with or without the name line."""
    starts = [k for k in range(len(lines) - 1) if lines[k].startswith("1 ") and lines[k + 1].startswith("2 ")]
    if not starts:
        raise ForeignTableError("the file is no TLE, OMM, OEM or JSON; a TLE has lines that begin with 1 and 2")
    if len(starts) > 1:
        names = ", ".join(lines[k][2:7] for k in starts[:5])
        raise ForeignTableError(
            f"the file holds {len(starts)} element sets ({names}); keep the newest of this spacecraft"
        )
    k = starts[0]
    name = lines[k - 1].removeprefix("0 ").strip() if k else None
    return OrbitFile("TLE", name, _designator(lines[k]), {"tle": [lines[k], lines[k + 1]]})


def _designator(line: str) -> str | None:
    """Return the international designator of a first line of elements."""
    found = _DESIGNATOR.fullmatch(line[9:17].strip())
    if found is None:
        return None
    century = 1900 if int(found.group(1)) >= _CENTURY_TURNS else 2000
    return f"{century + int(found.group(1))}-{found.group(2)}{found.group(3)}"


def _oem_value(content: str, keyword: str) -> str | None:
    """Return the first value of a keyword of an OEM."""
    found = re.search(rf"^{keyword}\s*=\s*(\S.*?)\s*$", content, re.MULTILINE)
    return None if found is None else found.group(1)
