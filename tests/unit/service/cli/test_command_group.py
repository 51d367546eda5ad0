"""Wrong values of options: said in sentences of this program, whatever library judged them, with exit code 2."""

import pytest
from typer.testing import CliRunner

from service.cli.app import app


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["ack", "abc"], "'alarm': must be a whole number"),
        (["ack", "0"], "'alarm': must be 1 or greater"),
        (["shelve", "1", "--hours", "x"], "'--hours': must be a number"),
        (["handover", "--format", "pdf"], "'--format': 'pdf' is not one of 'md', 'html'."),
        (["demo", "inject", "hail"], "'kind': 'hail' is not one of 'rain', "),
        (["torque", "report", "1", "lost"], "'outcome': 'lost' is not one of 'sent', "),
    ],
)
def test_a_wrong_value_is_said_in_words_of_this_program(command: list[str], said: str) -> None:
    done = CliRunner().invoke(app, command, env={"SOO_SPACECRAFT": "yamal-202", "SOO_KEY": "a-key"})
    assert done.exit_code == 2
    assert f"Invalid value for {said}" in " ".join(done.stderr.split())
