"""Locks: who is granted what, who may run, what a client that leaves gives back."""

from analyzer_sim.lines.lock_table import LockAnswer, LockTable


def test_exclusive_lock_keeps_everybody_else_out() -> None:
    table = LockTable()
    assert table.request("a", "") is LockAnswer.SUCCESS
    assert (table.may_run("a"), table.may_run("b"), table.is_exclusive, table.holders) == (True, False, True, 1)
    assert table.request("b", "") is None
    assert table.request("b", "key") is None
    assert table.release("b") is LockAnswer.INVALID
    assert table.release("a") is LockAnswer.SUCCESS
    assert table.may_run("b")
    assert table.release("a") is LockAnswer.INVALID


def test_shared_lock_is_had_by_all_who_know_the_key() -> None:
    table = LockTable()
    assert table.request("a", "key") is LockAnswer.SUCCESS
    assert table.request("b", "key") is LockAnswer.SUCCESS
    assert table.request("c", "other") is None
    assert table.request("c", "") is None
    assert [table.may_run(client) for client in "abc"] == [True, True, False]
    assert (table.is_exclusive, table.holders) == (False, 2)
    assert table.release("a") is LockAnswer.SUCCESS_SHARED
    assert table.release("b") is LockAnswer.SUCCESS_SHARED
    assert table.request("c", "other") is LockAnswer.SUCCESS


def test_one_who_shares_may_have_the_exclusive_lock_on_top_and_gives_it_back_first() -> None:
    table = LockTable()
    table.request("a", "key")
    table.request("b", "key")
    assert table.request("a", "") is LockAnswer.SUCCESS
    assert [table.may_run(client) for client in "ab"] == [True, False]
    assert (table.is_exclusive, table.holders) == (True, 2)
    assert table.release("a") is LockAnswer.SUCCESS
    assert table.may_run("b")
    assert table.release("a") is LockAnswer.SUCCESS_SHARED


def test_a_lock_asked_for_twice_is_invalid() -> None:
    table = LockTable()
    table.request("a", "")
    assert table.request("a", "") is LockAnswer.INVALID
    assert table.request("a", "key") is LockAnswer.SUCCESS
    assert table.request("a", "key") is LockAnswer.INVALID


def test_a_client_that_leaves_holds_nothing() -> None:
    table = LockTable()
    table.request("a", "key")
    table.request("a", "")
    table.drop("a")
    table.drop("b")
    assert (table.holders, table.may_run("b"), table.request("b", "other")) == (0, True, LockAnswer.SUCCESS)
