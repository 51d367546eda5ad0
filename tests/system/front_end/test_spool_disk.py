"""The spool on a disk that really takes nothing more, and through a kill in the middle of writing."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

FAKES = Path(__file__).resolve().parents[2] / "fakes" / "drivers"
#: no file of the process may grow beyond the limit, until it is lifted
FULL = """
import json, resource, sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import spooled_rows as made
from service.frontend.spool.file import UploadLane
hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, hard))
with made.spool(Path(sys.argv[2])) as spool:
    kept = [spool.append(made.row(number)) for number in range(2000)]
    said = [each.code for each in spool.warnings]
    sent = 0
    while sent < 200:
        rows = spool.batch(UploadLane.LIVE, 0, 50)
        sent += len(rows)
        spool.settle(rows)
    resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    time.sleep(1.1)
    healed = spool.append(made.row(2000))
    left = [each.row.epoch_us for lane in (UploadLane.LIVE,) for each in spool.batch(lane, 0, 10_000)]
    print(json.dumps({"kept": sum(kept), "said": said, "healed": healed, "left": left, "sent": sent,
                      "after": [each.code for each in spool.warnings], "dropped": spool.state.dropped}))
"""


def test_a_disk_without_room_costs_no_row(tmp_path: Path) -> None:
    command = [sys.executable, "-c", FULL, str(FAKES), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert 0 < said["kept"] < 2000
    assert said["said"] in (["spool.disk_full"], ["spool.unwritable"])
    assert said["healed"]
    assert (said["after"], said["dropped"]) == ([], {})
    # the rows that were sent while nothing could be deleted are not sent again, and none of the others is missing
    assert said["left"] == list(range(said["sent"], 2001))
