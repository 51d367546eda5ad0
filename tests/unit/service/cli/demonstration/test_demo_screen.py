"""What the demonstration prints of its service: where its key is, never the key."""

import io
from types import SimpleNamespace

from rich.console import Console

from service.cli.demonstration.demo_screen import Presenter


def test_the_key_is_named_by_its_file(tmp_path):
    printed = io.StringIO()
    presenter = Presenter(Console(file=printed, width=400), 0.0, with_table=True)
    key_file = tmp_path / "administrator.key"
    key_file.write_text("soo_secret")
    presenter.announce("http://127.0.0.1:1", key_file)
    assert f"console http://127.0.0.1:1/console/, sign in with the key in {key_file}" in printed.getvalue()
    client, story = SimpleNamespace(service_url="http://127.0.0.1:1"), SimpleNamespace(spacecraft_id="sim")
    presenter._say_where(SimpleNamespace(client=client, story=story))
    assert f"Bearer $(cat {key_file})" in printed.getvalue()
    assert "soo_secret" not in printed.getvalue()
