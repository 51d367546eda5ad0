"""Keys of the demonstration's persons: made by the service, each in a file that its owner alone reads."""

from service.cli.demonstration.persons import two_persons, write_key


class Client:
    """A service that makes keys."""

    def request(self, method, path, body):
        assert (method, path) == ("POST", "/keys")
        return {"key": f"soo_{body['name']}_{body['role']}"}


def test_an_operator_and_an_approver_have_a_file_each(tmp_path):
    persons = two_persons(Client(), tmp_path)
    assert [(person.name, person.role, person.key) for person in persons] == [
        ("Anna", "operator", "soo_Anna_operator"),
        ("Boris", "approver", "soo_Boris_approver"),
    ]
    assert [person.key_file.stat().st_mode & 0o777 for person in persons] == [0o600, 0o600]


def test_a_file_of_an_earlier_run_that_others_may_read_is_replaced(tmp_path):
    path = tmp_path / "administrator.key"
    path.write_text("old")
    path.chmod(0o644)
    write_key(path, "new")
    assert (path.read_text(), path.stat().st_mode & 0o777) == ("new\n", 0o600)
