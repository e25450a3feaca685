import numpy as np
import pytest

from hm_driver.errors import ConfigurationError
from teaching.accumulator import Accumulator, BackgroundUpdate
from teaching.lwr import LWR


def fill(accumulator, n, *, C=1.0, start=0):
    return [b for i in range(start, start + n) if (b := accumulator.add((i, -i), 10.0 * i, C)) is not None]


def test_a_full_buffer_is_given_out_shuffled_and_emptied(rng):
    accumulator = Accumulator(100, rng=rng)
    (batch,) = fill(accumulator, 100)
    assert accumulator.count == 0
    assert batch.X.shape == (100, 2)
    assert batch.Y.shape == (100, 1)
    assert sorted(batch.X[:, 0]) == list(range(100))
    assert batch.X[:, 0].tolist() != list(range(100))
    np.testing.assert_array_equal(batch.Y[:, 0], 10.0 * batch.X[:, 0])


@pytest.mark.parametrize("C", [0.0, 0.5, 0.9999999])
def test_nothing_is_collected_unless_the_human_alone_is_in_control(C, rng):
    accumulator = Accumulator(10, rng=rng)
    fill(accumulator, 3)
    fill(accumulator, 20, C=C)
    assert accumulator.count == 3


def test_no_sample_is_lost_between_two_batches(rng):
    accumulator = Accumulator(10, rng=rng)
    batches = fill(accumulator, 25)
    assert len(batches) == 2
    assert accumulator.count == 5
    assert sorted(np.concatenate([b.X[:, 0] for b in batches])) == list(range(20))


def test_a_batch_is_not_overwritten_by_later_samples(rng):
    accumulator = Accumulator(5, rng=rng)
    (batch,) = fill(accumulator, 5)
    before = batch.X.copy()
    fill(accumulator, 4, start=50)
    np.testing.assert_array_equal(batch.X, before)


def test_down_sampling_keeps_every_third_of_the_collected_samples(rng):
    (batch,) = fill(Accumulator(10, 3, rng=rng), 10)
    assert sorted(batch.X[:, 0]) == [0, 3, 6, 9]


def test_one_seed_gives_one_order():
    orders = [fill(Accumulator(50, rng=np.random.default_rng(3)), 50)[0].X.tolist() for _ in range(2)]
    assert orders[0] == orders[1]


def test_what_is_left_can_be_flushed_or_cleared(rng):
    accumulator = Accumulator(100, rng=rng)
    assert accumulator.flush() is None
    fill(accumulator, 29)
    assert accumulator.flush(minimum=30) is None
    assert accumulator.count == 29
    assert len(accumulator.flush(minimum=29).X) == 29
    fill(accumulator, 5)
    accumulator.clear()
    assert accumulator.count == 0


@pytest.mark.parametrize(("n_acc", "downsample"), [(0, 1), (10, 0), (10, 11), (1.5, 1), (True, 1)])
def test_sizes_out_of_range_are_refused(n_acc, downsample, rng):
    with pytest.raises(ConfigurationError):
        Accumulator(n_acc, downsample, rng=rng)


@pytest.mark.parametrize("samples_per_tick", [1, 7, 50, 1000])
def test_learning_aside_equals_learning_at_once(samples_per_tick, rng):
    X, Y = rng.uniform(-0.2, 0.2, (100, 2)), rng.normal(size=(100, 1))
    skill = LWR()
    update = BackgroundUpdate(skill.copy(), X, Y, samples_per_tick)
    steps = 1
    while (learned := update.step()) is None:
        steps += 1
    assert steps == -(-100 // samples_per_tick)
    assert update.remaining == 0
    assert skill.n_models == 0
    for a, b in zip(learned.models, LWR().partial_fit(X, Y).models, strict=True):
        np.testing.assert_array_equal(a, b)


def test_learning_aside_can_be_finished_at_once(rng):
    update = BackgroundUpdate(LWR(), rng.uniform(-0.2, 0.2, (100, 2)), np.ones((100, 1)), 3)
    update.step()
    assert update.finish().n_samples == 100


def test_a_step_of_no_sample_is_refused():
    with pytest.raises(ConfigurationError):
        BackgroundUpdate(LWR(), np.zeros((1, 2)), np.zeros((1, 1)), 0)
