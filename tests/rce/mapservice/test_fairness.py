"""Fair queue of jobs."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from rce.mapservice.fairness import FairQueue


def drain(queue: FairQueue) -> list[str]:
    served = []
    while (job := queue.pop(Counter())) is not None:
        served.append(job)
    return served


def test_user_with_many_jobs_does_not_delay_others() -> None:
    queue = FairQueue(1)
    for job in ("a1", "a2", "a3", "a4"):
        queue.push("ann", job)
    queue.push("bob", "b1")
    queue.push("cleo", "c1")
    served = drain(queue)
    assert sorted(served[:3]) == ["a1", "b1", "c1"]
    assert served[3:] == ["a2", "a3", "a4"]


def test_least_recently_served_user_is_next() -> None:
    queue = FairQueue(1)
    queue.push("ann", "a1")
    queue.push("bob", "b1")
    assert [queue.pop(Counter()), queue.pop(Counter())] == ["b1", "a1"]
    queue.push("ann", "a2")
    queue.push("bob", "b2")
    assert drain(queue) == ["b2", "a2"]


def test_running_jobs_of_a_user_are_limited() -> None:
    queue = FairQueue(2)
    for job in ("a1", "a2", "a3"):
        queue.push("ann", job)
    assert queue.pop(Counter(ann=1)) == "a1"
    assert queue.pop(Counter(ann=2)) is None
    queue.push("bob", "b1")
    assert queue.pop(Counter(ann=2)) == "b1"


def test_jobs_can_be_removed_and_put_first() -> None:
    queue = FairQueue(1)
    for job in ("a1", "a2", "a3"):
        queue.push("ann", job)
    assert queue.remove("ann", "a2")
    assert not queue.remove("ann", "a2")
    assert not queue.remove("bob", "a1")
    queue.push("ann", "a0", first=True)
    assert (queue.ahead("ann", "a3"), queue.count("ann")) == (2, 3)
    assert drain(queue) == ["a0", "a1", "a3"]


@given(st.lists(st.sampled_from("abc"), max_size=30))
def test_no_job_is_lost_and_users_alternate(users: list[str]) -> None:
    queue = FairQueue(1)
    for number, user in enumerate(users):
        queue.push(user, f"{user}{number}")
    served = drain(queue)
    assert sorted(served) == sorted(f"{user}{number}" for number, user in enumerate(users))
    for user in set(users):
        own = [job for job in served if job[0] == user]
        assert own == sorted(own, key=lambda job: int(job[1:]))
        places = [index for index, job in enumerate(served) if job[0] == user]
        for before, after in pairwise(places):
            between = Counter(job[0] for job in served[before + 1 : after])
            assert all(count <= 1 for count in between.values())
