"""Orbits and messages of other programs: two-line elements, CCSDS messages in keyword = value, XML, JSON and CSV.

XML becomes keyword = value first, so that each message has one reader. Whatever a library raises becomes a
`ForeignTableError` with what to do next.
"""

import csv
import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, Literal, NamedTuple

import numpy as np

from service.core.geometry.frames import attitude_of_quaternion, matrix_of_quaternion, quaternion_of_matrix
from service.errors import InvalidInputError
from service.formats.ccsds import Segment, epoch_of, is_useable, read_segments, require, require_one_object
from service.formats.ephemeris import read_mean_elements, read_oem, read_tle, utc_us
from service.formats.foreign.table import ForeignTableError, Table, word_set
from service.formats.tdm import read_tdm
from service.records.catalogue import Ephemeris
from service.records.epoch import format_epoch
from service.records.levels.attitude import FloatArray

#: keyword that begins each message, by its element in XML
VERSIONS = {"oem": "CCSDS_OEM_VERS", "omm": "CCSDS_OMM_VERS", "aem": "CCSDS_AEM_VERS", "tdm": "CCSDS_TDM_VERS"}
_PAIR = re.compile(r"\s*([A-Z][A-Z0-9_]*)\s*=\s*(.*?)\s*(?:\[([^\]]*)\])?\s*")
_DESIGNATOR = re.compile(r"(\d{2})(\d{3})([A-Z]{1,3})")
#: of years in two-line elements
_CENTURY_TURNS = 57
#: units that the readers take, lower case; others of the same keywords are refused
_UNITS = word_set(
    "km km/s km/s**2 km**2 km**2/s km**2/s**2 km**3/s**2 deg deg/s rev/day rev/day**2 rev/day**3 1/er dbw dbhz s d",
    "m**2 kg m**2/kg hz % n/a",
)
#: elements of a record of XML in the order of keyword = value, by message
_RECORDS: dict[str, tuple[tuple[str, ...], ...]] = {
    "oem": (("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT"),),
    "aem": (
        ("Q1", "Q2", "Q3", "QC"),
        ("ANGLE_1", "ANGLE_2", "ANGLE_3"),
        ("rotation1", "rotation2", "rotation3"),
    ),
    "tdm": (),
}


class OrbitFile(NamedTuple):
    """An orbit as it came, and as the service will have it."""

    #: TLE, OMM, OEM, or interface document
    form: str
    name: str | None
    #: international designator YYYY-NNNP
    cospar_id: str | None
    #: body of ``PUT .../ephemeris``
    body: dict[str, Any]
    #: None: the body is an interface document, which its own schema reads
    ephemeris: Ephemeris | None


def read_orbit_file(text: str) -> OrbitFile:
    """Return the orbit of a file.

    Parameters
    ----------
    text : str
        Two-line elements, an OMM (JSON, XML, keyword = value, CSV), an OEM (keyword = value, XML), or a document of the
        interface.

    Raises
    ------
    ForeignTableError
        None of these, several objects, or an orbit that cannot be used.
    """
    content = message_text(text)
    try:
        if content.startswith("CCSDS_OEM_VERS"):
            name, designator = (_first_value(content, keyword) for keyword in ("OBJECT_NAME", "OBJECT_ID"))
            return OrbitFile("OEM", name, designator, {"oem": content}, read_oem(content))
        if content.startswith(("{", "[")):
            return _from_json(content)
        if content.startswith("CCSDS_OMM_VERS"):
            return _of_omm(_members(content))
        if "MEAN_MOTION" in content.partition("\n")[0]:
            separator = max(",;\t|", key=content.partition("\n")[0].count)
            return _of_omm(_single(list(csv.DictReader(io.StringIO(content), delimiter=separator))))
        return _from_lines([line.rstrip() for line in content.splitlines() if line.strip()])
    except InvalidInputError as error:
        raise ForeignTableError(error.detail) from None


def message_text(text: str) -> str:
    """Return a text without byte order mark, comments and blanks before the first keyword; XML as keyword = value."""
    content = text.removeprefix("\ufeff").strip()
    while content.startswith("COMMENT"):
        content = content.partition("\n")[2].lstrip()
    return _keyword_text(content) if content.startswith("<") else content


def _from_json(content: str) -> OrbitFile:
    """Return the orbit of JSON: an OMM or a list with one, or a document of the interface."""
    try:
        document = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ForeignTableError(f"the file is no JSON: {error}") from None
    entries = document if isinstance(document, list) else [document]
    if not entries or not all(isinstance(each, dict) for each in entries):
        raise ForeignTableError("the file holds no JSON object with an orbit")
    if "MEAN_MOTION" in entries[0]:
        return _of_omm(_single(entries))
    body: dict[str, Any] = _single(entries)
    lines = body.get("tle")
    is_elements = isinstance(lines, list) and len(lines) == 2 and isinstance(lines[0], str)
    return OrbitFile("interface document", None, _designator(lines[0]) if is_elements and lines else None, body, None)


def _single(entries: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the only entry of a file."""
    if len(entries) != 1:
        names = ", ".join(str(each.get("OBJECT_NAME", "?")) for each in entries[:5])
        raise ForeignTableError(f"the file holds {len(entries)} objects ({names}); keep the one of this spacecraft")
    return entries[0]


def _members(content: str) -> dict[str, str]:
    """Return the members of an OMM, keyword = value; one that occurs twice with two values is refused."""
    found: dict[str, str] = {}
    for line in content.splitlines():
        pair = _PAIR.fullmatch(line)
        if pair is None or line.startswith("COMMENT"):
            continue
        keyword, value, unit = pair.group(1), pair.group(2), pair.group(3)
        _check_unit(keyword, unit)
        if found.setdefault(keyword, value) != value:
            raise ForeignTableError(f"{keyword} is {found[keyword]} and {value}; keep one object and one epoch")
    return found


def _of_omm(members: Mapping[str, Any]) -> OrbitFile:
    """Return the orbit of mean elements as the track that SGP4 gives, which no text of two lines rounds."""
    stated = {str(name).strip(): str(value).strip() for name, value in members.items() if value not in (None, "")}
    if "BSTAR" not in stated and "BTERM" in stated:
        raise ForeignTableError("the OMM has BTERM in place of BSTAR: elements of SGP4-XP; ask for SGP4 elements")
    ephemeris = read_mean_elements(stated)
    track = ephemeris.track
    body: dict[str, Any] = {
        "ascending_nodes": [format_epoch(each) for each in ephemeris.ascending_nodes_us],
        "nodal_period_s": ephemeris.nodal_period_s,
    }
    if track is not None:
        # whole turns bring the longitudes into the range of the interface, and leave the track without a jump
        turns_deg = 360.0 * np.ceil((-180.0 - min(track.longitude_deg)) / 360.0)
        body["track"] = {
            "epochs": [format_epoch(each) for each in track.epochs_us],
            "latitude_deg": list(track.latitude_deg),
            "longitude_deg": [each + turns_deg for each in track.longitude_deg],
        }
    return OrbitFile("OMM", stated.get("OBJECT_NAME"), stated.get("OBJECT_ID"), body, ephemeris)


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
    pair = [lines[k], lines[k + 1]]
    return OrbitFile("TLE", name, _designator(lines[k]), {"tle": pair}, read_tle(pair))


def _designator(line: str) -> str | None:
    """Return the international designator of a first line of elements."""
    found = _DESIGNATOR.fullmatch(line[9:17].strip())
    if found is None:
        return None
    century = 1900 if int(found.group(1)) >= _CENTURY_TURNS else 2000
    return f"{century + int(found.group(1))}-{found.group(2)}{found.group(3)}"


def _first_value(content: str, keyword: str) -> str | None:
    found = re.search(rf"^\s*{keyword}\s*=\s*(\S.*?)\s*$", content, re.MULTILINE)
    return None if found is None else found.group(1)


def _check_unit(keyword: str, unit: str | None) -> None:
    """Refuse a unit that the readers would take for another."""
    if unit and unit.strip().lower() not in _UNITS:
        raise ForeignTableError(f"{keyword} is in {unit[:20]}; export the message in the units of its standard")


def _keyword_text(content: str) -> str:
    """Return a message of XML, whatever its namespace, as keyword = value."""
    # a parser without entities and external documents
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        root = fromstring(re.sub(r"^<\?xml[^>]*\?>", "", content), forbid_dtd=True)
    except DefusedXmlException:
        raise ForeignTableError("an XML message has no document type; remove it") from None
    except (ParseError, ValueError) as error:
        raise ForeignTableError(f"the file is no XML: {error}") from None
    messages = [each for each in root.iter() if _local(each) in VERSIONS]
    if len(messages) != 1:
        kinds = ", ".join(_local(each).upper() for each in messages[:5]) or f"its root is {_local(root)}"
        raise ForeignTableError(
            f"the XML holds {len(messages)} messages of orbit, attitude or tracking ({kinds}); keep one of OEM, OMM,"
            " AEM, TDM and of this spacecraft"
        )
    kind = _local(messages[0])
    lines = [f"{VERSIONS[kind]} = {messages[0].get('version', '1.0')}"]
    for segment in (each for each in messages[0].iter() if _local(each) == "segment"):
        lines += _segment_lines(kind, segment)
    return "\n".join(lines) + "\n"


def _local(element: Any) -> str:
    """Return the name of an element without its namespace; comments and instructions have none."""
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _leaves(element: Any) -> list[tuple[str, str]]:
    """Return names and texts of the elements without children, in their order."""
    found = []
    for each in element.iter():
        if len(each) == 0 and _local(each) not in ("", "COMMENT"):
            _check_unit(_local(each), each.get("units"))
            found.append((_local(each), " ".join((each.text or "").split())))
    return found


def _segment_lines(kind: str, segment: Any) -> Iterator[str]:
    """Yield a segment of XML, line by line."""
    parts = {_local(each): each for each in segment}
    if "metadata" not in parts or "data" not in parts:
        raise ForeignTableError("a segment of the XML message has no metadata or no data")
    meta = [(name, text) for name, text in _leaves(parts["metadata"]) if name != "QUATERNION_TYPE"]
    if kind == "omm":
        yield from (f"{name} = {text}" for name, text in (*meta, *_leaves(parts["data"])))
        return
    yield from ("META_START", *(f"{name} = {text}" for name, text in meta), "META_STOP")
    yield from () if kind == "oem" else ("DATA_START",)
    for record in parts["data"]:
        named = dict(_leaves(record))
        if "EPOCH" not in named or "covariance" in _local(record).lower():
            continue
        epoch = named.pop("EPOCH")
        form = next((names for names in _RECORDS[kind] if set(names) <= set(named)), None)
        if kind == "tdm":
            yield from (f"{name} = {epoch} {text}" for name, text in named.items())
        elif form is None:
            raise ForeignTableError(f"a record of the XML message holds {', '.join(named)}, which is not read")
        else:
            yield " ".join((epoch, *(named[name] for name in form)))
    yield from () if kind == "oem" else ("DATA_STOP",)


#: nadir frames: z to the Earth, y against the orbit's momentum; turning or not, the attitude of an instant is the same
_NADIR = ("LVLH_ROTATING", "LVLH_INERTIAL", "LVLH")
_BODY = ("SC_BODY_1", "SC_BODY")
_UNIT_LENGTH = 1e-3
#: of the scalar of a satellite that points to the Earth within 50 deg
_NEAR_ONE = 0.9


def read_attitude_message(text: str) -> tuple[np.ndarray, FloatArray]:
    """Return epochs, microseconds UTC, and yaw, roll and pitch, deg, shape (T, 3), of an AEM.

    Raises
    ------
    ForeignTableError
        No message, another frame, type or time system, quaternions not of unit length, or a scalar at another position
        than the metadata state.
    """
    epochs, angles = [np.empty(0, dtype=np.int64)], [np.empty((0, 3))]
    try:
        segments = read_segments(message_text(text), VERSIONS["aem"])
        require_one_object(segments)
        for segment in segments:
            epochs_us, matrices = _attitude_states(segment)
            inside = is_useable(segment.meta, epochs_us)
            epochs.append(utc_us(epochs_us[inside], segment.meta.get("TIME_SYSTEM", "").upper()))
            # a matrix of the other direction is the transposed one
            turned = np.swapaxes(matrices, -1, -2) if _is_reversed(segment) else matrices
            angles.append(attitude_of_quaternion(quaternion_of_matrix(turned[inside])))
    except InvalidInputError as error:
        raise ForeignTableError(error.detail) from None
    except ValueError as error:
        raise ForeignTableError(str(error)) from None
    return np.concatenate(epochs), np.concatenate(angles)


def message_table(names: Sequence[str], epochs_us: Sequence[int], columns: Iterable[Sequence[Any]], note: str) -> Table:
    """Return a message as a table of texts, so that the rules of tables judge it; NaN and None are empty cells."""
    import pyarrow as pa

    texts = [["" if each is None or each != each else str(each) for each in column] for column in columns]
    cells = [pa.array(each, pa.string()) for each in ([format_epoch(each) for each in epochs_us], *texts)]
    return Table(["epoch", *names], cells, np.arange(1, len(epochs_us) + 1), notes=[note], is_standard=True)


def attitude_table(text: str) -> Table:
    """Return the angles of an AEM as a table."""
    epochs_us, angles_deg = read_attitude_message(text)
    return message_table(("yaw_deg", "roll_deg", "pitch_deg"), epochs_us.tolist(), angles_deg.T.tolist(), "AEM")


def _attitude_states(segment: Segment) -> tuple[np.ndarray, FloatArray]:
    """Return epochs of the message's own time system and matrices from frame A to B, or as ATTITUDE_DIR says."""
    require(segment, {"ATTITUDE_TYPE": ("QUATERNION", "EULER_ANGLE")})
    is_euler = segment.meta["ATTITUDE_TYPE"].upper() == "EULER_ANGLE"
    count = 3 if is_euler else 4
    epochs_us, values = np.zeros(len(segment.data), dtype=np.int64), np.full((len(segment.data), count), np.nan)
    for k, (number, content) in enumerate(segment.data):
        cells = content.split()
        with suppress(ValueError):
            values[k] = [float(value) for value in cells[-count:]]
        if len(cells) <= count or not np.isfinite(values[k]).all():
            parts = "three angles" if is_euler else "the four parts of a quaternion"
            raise ForeignTableError(f"line {number}: a row is an epoch and {parts}")
        epochs_us[k] = epoch_of(number, " ".join(cells[:-count]))
    return epochs_us, _euler(segment, values) if is_euler else _quaternions(segment, values)


def _quaternions(segment: Segment, quaternions: FloatArray) -> FloatArray:
    """Return matrices of quaternions; refuse those whose numbers contradict the metadata."""
    wrong = wrong_length(quaternions)
    if wrong.any():
        raise ForeignTableError(f"quaternion is not of unit length: {quaternions[wrong][0].tolist()}")
    stated = segment.meta.get("QUATERNION_TYPE", "LAST").lower()
    proven = scalar_of(quaternions)
    if len(quaternions) and proven != stated:
        shown = "at neither end" if proven is None else proven
        raise ForeignTableError(f"the message states the scalar {stated}, the numbers show it {shown}")
    return matrix_of_quaternion(np.roll(quaternions, -1, axis=1) if stated == "first" else quaternions)


def wrong_length(quaternions: FloatArray) -> np.ndarray:
    """Return which quaternions, shape (T, 4), are not of unit length."""
    return np.asarray(~(np.abs(np.linalg.norm(quaternions, axis=-1) - 1.0) < _UNIT_LENGTH))


def scalar_of(quaternions: FloatArray) -> Literal["first", "last"] | None:
    """Return whether the scalar of quaternions (T, 4) is first or last; None when neither end stays near one.

    From the nadir frame to the body of a satellite that points to the Earth the scalar is nearly one or minus one in
    nine of ten rows; of a quaternion from an inertial frame no part is.
    """
    share = np.mean(np.abs(quaternions) > _NEAR_ONE, axis=0) if len(quaternions) else np.zeros(4)
    if share[3] > _NEAR_ONE:
        return "last"
    return "first" if share[0] > _NEAR_ONE else None


def _euler(segment: Segment, angles_deg: FloatArray) -> FloatArray:
    """Return matrices of three turns one after the other about the axes that EULER_ROT_SEQ names."""
    from scipy.spatial.transform import Rotation

    stated = segment.meta.get("EULER_ROT_SEQ", "").upper()
    sequence = stated.translate(str.maketrans("123", "XYZ"))
    if re.fullmatch(r"([XYZ])(?!\1)([XYZ])(?!\2)[XYZ]", sequence) is None:
        raise ForeignTableError(f"EULER_ROT_SEQ = {stated or 'nothing'}; understood: three axes such as 321 or ZYX")
    if not len(angles_deg):
        return np.empty((0, 3, 3))
    # turns of the frame are the transposed ones of vectors
    return np.swapaxes(Rotation.from_euler(sequence, angles_deg, degrees=True).as_matrix(), -1, -2)


def _is_reversed(segment: Segment) -> bool:
    """Return whether a segment states the rotation from the body to the nadir frame; refuse other frames."""
    first, second = (segment.meta.get(f"REF_FRAME_{which}", "").upper() for which in "AB")
    is_swapped = first in _BODY
    if is_swapped:
        first, second = second, first
    if first not in _NADIR or second not in _BODY:
        wanted = f"{', '.join(_NADIR)} and {', '.join(_BODY)}"
        raise ForeignTableError(
            f"REF_FRAME_A = {segment.meta.get('REF_FRAME_A')}, REF_FRAME_B = {segment.meta.get('REF_FRAME_B')};"
            f" understood: {wanted}; turn inertial attitudes into the orbital frame first"
        )
    direction = segment.meta.get("ATTITUDE_DIR", "A2B").upper()
    if direction not in ("A2B", "B2A"):
        raise ForeignTableError(f"ATTITUDE_DIR = {direction}; understood: A2B, B2A")
    return is_swapped != (direction == "B2A")


def tracking_table(text: str) -> Table:
    """Return the carrier powers of a TDM as a table of one level a line.

    ``TRACK_ID`` is ``source/carrier`` as this service writes it, or the name of a carrier; a segment without one is
    called by its number.
    """
    try:
        tracks = read_tdm(message_text(text))
    except InvalidInputError as error:
        raise ForeignTableError(error.detail) from None
    rows = []
    for number, track in enumerate(tracks, start=1):
        source, _, carrier = track.track_id.rpartition("/")
        pairs = zip(track.epochs_us.tolist(), track.power_dbm.tolist(), strict=True)
        rows += [(epoch_us, source, carrier or f"segment {number}", level) for epoch_us, level in pairs]
    if not rows:
        raise ForeignTableError("the message holds no CARRIER_POWER")
    epochs_us, *columns = zip(*rows, strict=True)
    return message_table(("source", "carrier", "level_dbm"), epochs_us, columns, "TDM")
