from adapters.backoff import Backoff


def test_waits_double_up_to_the_last_and_begin_again() -> None:
    backoff = Backoff(0.5, 3.0)
    assert [backoff.next() for _ in range(5)] == [0.5, 1.0, 2.0, 3.0, 3.0]
    backoff.reset()
    assert backoff.wait_s == 0.5
    assert [backoff.next() for _ in range(2)] == [0.5, 1.0]
    assert backoff.wait_s == 2.0
