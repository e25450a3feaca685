import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from teaching.lwpr import LWPR
from teaching.lwr import LWR
from teaching.messages import (
    ARBITRATION,
    CHANNELS,
    HAND_STATE,
    LEARNER_STATE,
    pack_learner_state,
    unpack_models,
)


def parse(message, data):
    pool = descriptor_pool.DescriptorPool()
    files = descriptor_pb2.FileDescriptorSet.FromString(message.file_descriptor_set())
    for file in files.file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"hapticmaster.{message.name}"))
    return kind.FromString(data)


def test_topics_and_numbers_are_unique():
    assert len({channel.id for channel in CHANNELS}) == len({channel.topic for channel in CHANNELS}) == 3


def test_an_arbitration_is_read_back_as_it_was_written():
    values = [10, 1, 0.5, 0.51, *np.linspace(0.0, 1.0, 10).tolist(), 123, True, False, 0.003]
    read = parse(ARBITRATION, ARBITRATION.pack(*values))
    assert (read.C, read.w_max, read.accumulated, read.recorded, read.pending) == (
        0.5,
        0.51,
        123,
        True,
        False,
    )
    assert read.std == 0.003
    assert len(ARBITRATION.columns) == len(values)


def test_a_hand_state_is_read_back_as_it_was_written():
    read = parse(HAND_STATE, HAND_STATE.pack(1, *range(21)))
    assert (read.intended_velocity.x, read.contact_force.z) == (3.0, 14.0)


def test_the_learner_is_read_back_from_its_message(rng):
    X = rng.uniform(-0.2, 0.2, (100, 2))
    skill = LWR().partial_fit(X, X[:, 0])
    read = parse(LEARNER_STATE, pack_learner_state(5, 2, 0.75, skill, cause=1))
    assert read.cause == 1
    assert (read.update, read.samples, read.added, read.coverage) == (2, 100, skill.n_added, 0.75)
    models = unpack_models(
        read.n_inputs,
        read.n_outputs,
        read.centres,
        read.D,
        read.M,
        read.P,
        read.model_samples,
        read.model_born,
    )
    assert list(read.say) == [1.0] * skill.n_models
    assert list(read.variances) == skill.variances.ravel().tolist()
    for a, b in zip(models, skill.models, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_learner_whose_deviation_follows_from_more_than_its_models_logs_no_variances():
    read = parse(LEARNER_STATE, pack_learner_state(5, 1, 0.0, LWPR().partial_fit([[0.0, 0.0]], [0.1])))
    assert len(read.centres) == 2
    assert list(read.variances) == []
