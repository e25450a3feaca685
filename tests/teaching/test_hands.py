"""Hands and what they are made of: paths, memory, and the simulated demonstrator."""

import inspect
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hm_driver.errors import ConfigurationError
from teaching.hands.contract import Hand, HandIntent, PersonHand, Seen
from teaching.hands.learning import ClumsyHand, LearningHand, MistakenHand
from teaching.hands.memory import PlaneMemory
from teaching.hands.paths import Area, Walker, raster
from teaching.hands.recorded import RecordedHand
from teaching.hands.simulated import DemonstratorOptions, Doing, Kind, SimulatedHand

DT = 0.01
LEFT, RIGHT = Area(-0.2, 0.0, -0.2, 0.2), Area(0.0, 0.2, -0.2, 0.2)
PLANE = Area(-0.2, 0.2, -0.2, 0.2)
REFERENCE_FORCE = 10.0
CALM = {"force_noise": 0.0}


def see(x=-0.1, y=0.0, depth=0.05, *, force=10.0, C=1.0, surface=0, autonomous=False):
    return Seen((x, y, -depth), x, y, depth, force, C, surface, autonomous)


class Person:
    """A simulated hand whose intentions come true after a moment, on a plane of one stiffness an area."""

    def __init__(self, *, stiffness=(200.0, 200.0), depths=(0.05, 0.05), seed=1, **options):
        self.stiffness = stiffness
        self.hand = SimulatedHand(
            areas=[LEFT, RIGHT],
            depths=list(depths),
            reference_force=REFERENCE_FORCE,
            to_handle=lambda x, y, z: (x, y, z),
            surface_z=0.0,
            start=(-0.1, 0.0, 0.01),
            options=DemonstratorOptions(**options),
            rng=np.random.default_rng(seed),
        )
        self.x, self.y, self.depth = -0.1, 0.0, -0.01
        self.C = 1.0
        self.intents = []

    def surface(self):
        return 0 if LEFT.contains(self.x, self.y) else 1 if RIGHT.contains(self.x, self.y) else -1

    def force(self):
        return self.stiffness[max(0, self.surface())] * max(0.0, self.depth)

    def step(self):
        intent = self.hand.step(
            see(self.x, self.y, self.depth, force=self.force(), C=self.C, surface=self.surface()), DT
        )
        self.intents.append(intent)
        self.x, self.y = intent.position[:2]
        if self.C > 0.5:
            self.depth += (-intent.position[2] - self.depth) * DT / 0.03
        return intent

    def run(self, seconds):
        return [self.step() for _ in range(round(seconds / DT))]


# Paths

AREAS = st.builds(
    lambda x, y, width, length: Area(x, x + width, y, y + length),
    st.floats(-0.3, 0.2), st.floats(-0.3, 0.2), st.floats(0.01, 0.4), st.floats(0.01, 0.4),
)  # fmt: skip
POINTS = st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))


@given(AREAS, st.floats(0.01, 0.1), st.floats(0.0, 0.05), st.booleans(), POINTS)
def test_a_raster_stays_in_its_area_and_leaves_no_gap_wider_than_the_spacing(
    area, spacing, margin, along_x, start
):
    points = raster(area, spacing, margin, along_x=along_x, start=start)
    tiny = 1e-9
    for x, y in points:
        assert area.x_min - tiny <= x <= area.x_max + tiny
        assert area.y_min - tiny <= y <= area.y_max + tiny
    across = sorted({point[1 if along_x else 0] for point in points})
    assert all(b - a <= spacing + tiny for a, b in itertools.pairwise(across))
    low, high = (area.y_min, area.y_max) if along_x else (area.x_min, area.x_max)
    assert across[0] - low <= margin + tiny
    assert high - across[-1] <= margin + tiny


def test_a_raster_goes_to_and_fro():
    points = raster(Area(0.0, 0.2, 0.0, 0.1), 0.05, 0.0, start=(0.0, 0.0))
    ways = [(0.0, 0.0), (0.2, 0.0), (0.2, 0.05), (0.0, 0.05), (0.0, 0.1), (0.2, 0.1)]
    assert np.array(points) == pytest.approx(np.array(ways))


@given(POINTS, st.booleans())
def test_a_raster_begins_at_the_corner_nearest_to_where_one_comes_from(start, along_x):
    first = raster(PLANE, 0.05, 0.01, along_x=along_x, start=start)[0]
    corners = [(sx * 0.19, sy * 0.19) for sx in (-1, 1) for sy in (-1, 1)]
    nearest = min(math.dist(start, corner) for corner in corners)
    assert math.dist(start, first) == pytest.approx(nearest, abs=1e-9)


@given(st.lists(POINTS, min_size=1, max_size=6), st.sampled_from((math.inf, 1.0, 0.3)))
def test_a_walker_reaches_every_way_point_and_never_exceeds_its_speed(points, acceleration):
    walker = Walker((0.0, 0.0), 0.2, acceleration)
    walker.go(points)
    passed = []
    for _ in range(20_000):
        if walker.is_done:
            break
        before = walker.position
        left = walker.way_points_left
        walker.step(DT)
        assert math.dist(before, walker.position) <= 0.2 * DT + 1e-9
        assert math.hypot(*walker.velocity) <= 0.2 + 1e-6
        passed += points[len(points) - left : len(points) - walker.way_points_left]
    assert passed == points
    assert walker.position == pytest.approx(points[-1])


def test_a_walker_starts_and_brakes_with_its_acceleration():
    walker = Walker((0.0, 0.0), 0.2, 0.5)
    walker.go([(0.3, 0.0)])
    speeds = [0.0]
    while not walker.is_done:
        walker.step(DT)
        speeds.append(walker.velocity[0])
    assert max(speeds) == pytest.approx(0.2)
    assert max(b - a for a, b in itertools.pairwise(speeds)) <= 0.5 * DT + 1e-9
    assert speeds[-1] <= 0.02


def test_a_walker_without_acceleration_turns_at_full_speed():
    walker = Walker((0.0, 0.0), 0.2)
    walker.go([(0.005, 0.0), (0.005, 0.1)])
    for k in range(1, 20):
        x, y = walker.step(DT)
        assert x + y == pytest.approx(0.2 * DT * k)


def test_a_walker_that_is_not_moving_stands_still():
    walker = Walker((0.1, 0.2), 0.2)
    walker.go([(1.0, 1.0)])
    assert walker.step(DT, moving=False) == (0.1, 0.2)
    assert walker.velocity == (0.0, 0.0)
    assert walker.way_points == [(1.0, 1.0)]


# Memory


def remember(memory, x, y, C, seconds=0.1):
    for _ in range(round(seconds / DT)):
        memory.see(x, y, C, DT)


def test_places_where_he_was_in_control_are_remembered_as_taught_once():
    memory = PlaneMemory([PLANE], cell=0.05)
    remember(memory, 0.1, 0.1, 1.0)
    remember(memory, -0.1, 0.1, 1.0)
    remember(memory, 0.1, 0.1, 1.0)
    assert memory.taught == [(0.1, 0.1), (-0.1, 0.1)]
    memory.note_update()
    assert memory.taught == []


def test_a_loss_of_control_over_an_unknown_place_makes_him_suspect_an_update():
    memory = PlaneMemory([PLANE], cell=0.05, suspicion=0.5)
    remember(memory, 0.1, 0.1, 1.0, 1.0)
    assert not memory.suspects
    remember(memory, 0.1, 0.1, 0.0, 0.4)
    assert not memory.suspects
    remember(memory, 0.1, 0.15, 0.0, 0.2)
    assert memory.suspects
    assert memory.look_back() == (0.1, 0.1)


def test_what_turns_out_to_be_the_skills_own_is_dismissed_and_suspected_no_more():
    memory = PlaneMemory([PLANE], cell=0.05, suspicion=0.5)
    remember(memory, 0.1, 0.1, 1.0, 1.0)
    remember(memory, 0.0, 0.1, 0.0, 1.0)
    memory.dismiss()
    remember(memory, 0.0, 0.1, 0.0, 2.0)
    assert not memory.suspects


def test_a_place_crossed_in_the_blend_tells_nothing():
    memory = PlaneMemory([PLANE], cell=0.05)
    remember(memory, 0.1, 0.1, 1.0)
    remember(memory, 0.1, 0.15, 0.7, 5.0)
    assert not memory.suspects
    assert memory.taught == [(0.1, 0.1)]


def test_he_looks_next_at_the_nearest_place_that_he_does_not_know():
    memory = PlaneMemory([PLANE], cell=0.1)
    assert memory.next_place(0.16, 0.16) == pytest.approx((0.15, 0.15))
    remember(memory, 0.15, 0.15, 0.0)
    x, y = memory.next_place(0.16, 0.14)
    assert (x, y) == pytest.approx((0.15, 0.05))


def test_with_nothing_unknown_he_goes_to_his_own_oldest_place():
    memory = PlaneMemory([PLANE], cell=0.2)
    places = [(-0.1, -0.1), (0.1, 0.1), (-0.1, 0.1), (0.1, -0.1)]
    for place, C in zip(places, (0.0, 1.0, 1.0, 0.0), strict=True):
        remember(memory, *place, C)
    assert memory.next_place(-0.1, -0.1) == pytest.approx((0.1, 0.1))


@given(st.lists(st.tuples(POINTS, st.sampled_from((0.0, 0.3, 1.0))), max_size=60))
def test_whatever_he_has_seen_he_finds_a_place_on_the_plane(seen):
    memory = PlaneMemory([LEFT, RIGHT], cell=0.05)
    for place, C in seen:
        memory.see(*place, C, 0.1)
        if memory.suspects:
            memory.look_back()
            memory.note_update()
    assert PLANE.contains(*memory.next_place(0.0, 0.0))


# Contract


def made(kind, **options):
    """A hand of a class, as `Person` makes the expert."""
    return kind(
        areas=[LEFT, RIGHT],
        depths=[0.05, 0.05],
        reference_force=REFERENCE_FORCE,
        to_handle=lambda x, y, z: (x, y, z),
        surface_z=0.0,
        start=(-0.1, 0.0, 0.01),
        options=DemonstratorOptions(**options),
        rng=np.random.default_rng(1),
    )


def replayed():
    intents = [HandIntent((0.01 * k, 0.0, 0.0), *[(1.0, 1.0, 1.0)] * 4) for k in range(5)]
    return RecordedHand([DT * k for k in range(5)], intents)


HANDS = {
    "person": PersonHand,
    "expert": lambda: Person().hand,
    "novice": lambda: made(ClumsyHand, practised=False),
    "learning": lambda: made(LearningHand, practised=False),
    "mistaken": lambda: made(MistakenHand),
    "recorded": replayed,
}


def hands():
    return {name: make() for name, make in HANDS.items()}


@pytest.mark.parametrize("name", sorted(HANDS))
def test_a_hand_answers_what_is_seen_with_an_intent_or_lets_go(name):
    hand: Hand = hands()[name]
    for C in (1.0, 0.6, 0.0, 1.0):
        intent = hand.step(see(C=C), DT)
        assert intent is None or isinstance(intent, HandIntent)
        for vector in intent or ():
            assert len(vector) == 3
            assert all(map(math.isfinite, vector))
        assert intent is None or min(*intent.stiffness, *intent.damping) >= 0.0
    assert hand.step(see(autonomous=True), DT) is None


def test_a_person_is_never_moved_by_the_session():
    assert PersonHand().step(see(), DT) is None


# What the demonstrator knows


def test_a_demonstrator_is_made_without_any_stiffness_of_the_plane():
    parameters = set(inspect.signature(SimulatedHand.__init__).parameters) - {"self"}
    assert parameters == {
        "areas", "depths", "reference_force", "to_handle", "surface_z", "start", "options", "rng",
        "screen",
    }  # fmt: skip
    assert not [name for name in Seen._fields if "stiff" in name]


# What the demonstrator does


def test_out_of_control_he_relaxes_in_z_within_0_2_s_and_keeps_hold_in_x_and_y():
    person = Person(**CALM)
    held = person.run(1.0)[-1]
    assert held.stiffness == (1000.0, 1000.0, 1000.0)
    person.C = 0.0
    relaxed = person.run(0.2)[-1]
    assert relaxed.stiffness[2] <= 20.0
    assert relaxed.damping[2] <= held.damping[2] / 10.0
    assert relaxed.stiffness[:2] == held.stiffness[:2]
    assert relaxed.damping[:2] == held.damping[:2]


def test_relaxed_he_lets_the_skill_carry_his_hand_and_pulls_nowhere():
    person = Person(**CALM)
    person.run(1.0)
    person.C = 0.0
    person.run(0.5)
    person.depth = 0.09
    assert person.run(1.0)[-1].position[2] == pytest.approx(-0.09, abs=1e-4)


def test_in_control_again_he_takes_hold_within_his_grip_time():
    person = Person(**CALM)
    person.C = 0.0
    person.run(0.5)
    person.C = 1.0
    assert person.run(0.1)[-1].stiffness[2] == pytest.approx(1000.0)


def test_he_changes_the_depth_for_another_colour_only_after_his_lag():
    person = Person(depths=(0.05, 0.02), lag=0.15, correction=0.0, **CALM)
    hand = person.hand
    for _ in range(300):
        settled = hand.step(see(surface=0), DT)
    assert settled.position[2] == pytest.approx(-0.05, abs=1e-4)
    depths = [-hand.step(see(surface=1), DT).position[2] for _ in range(60)]
    begun = next(k for k, depth in enumerate(depths) if depth < 0.05 - 1e-4)
    assert begun * DT == pytest.approx(0.15, abs=1.5 * DT)
    assert depths[-1] == pytest.approx(0.02, abs=1e-3)
    assert max(abs(b - a) for a, b in itertools.pairwise(depths)) <= 0.25 * DT + 1e-9


def test_he_corrects_the_depth_that_he_learned_in_practice_by_the_force_that_he_sees():
    person = Person(stiffness=(200.0, 200.0), depths=(0.04, 0.05), examination=0.0, **CALM)
    person.run(0.5)
    early = person.force()
    person.run(8.0)
    assert early < 9.0
    assert person.force() == pytest.approx(REFERENCE_FORCE, abs=0.5)


@given(st.floats(100.0, 500.0), st.integers(0, 1000))
@settings(max_examples=12, deadline=None)
def test_a_novice_finds_the_force_by_feedback_alone_on_any_stiffness(stiffness, seed):
    person = Person(stiffness=(stiffness, stiffness), depths=(0.03,), practised=False, seed=seed)
    person.run(12.0)
    forces = []
    for _ in range(400):
        person.step()
        if person.surface() >= 0:
            forces.append(person.force())
    assert np.mean(forces) == pytest.approx(REFERENCE_FORCE, abs=1.0)


def test_he_teaches_each_object_in_turn_along_lines_that_are_close_enough():
    person = Person(**CALM)
    places = []
    while person.hand.doing in (Doing.APPROACHING, Doing.TEACHING) and len(places) < 10_000:
        person.step()
        if person.x > 0.01:
            break
        places.append((person.x, person.y))
    taught = np.array(places)
    assert person.hand.doing is Doing.APPROACHING, "he goes on without an update, once he has taught enough"
    assert len(places) > 1000
    for x, y in [(-0.19, -0.19), (-0.1, 0.0), (-0.02, 0.19), (-0.15, 0.1)]:
        assert np.hypot(taught[:, 0] - x, taught[:, 1] - y).min() < 0.02


def test_he_examines_the_skill_after_an_update_and_then_takes_the_next_object():
    person = Person(examination=1.0, **CALM)
    person.run(15.0)
    person.C = 0.0
    seen = {person.hand.doing}
    for _ in range(4000):
        person.step()
        seen.add(person.hand.doing)
        if person.x > 0.02:
            break
    assert Doing.EXAMINING in seen
    assert person.x > 0.02


def test_he_lets_go_when_the_autonomous_run_begins():
    person = Person()
    person.run(0.5)
    assert person.hand.step(see(autonomous=True), DT) is None


def test_one_seed_is_one_motion_and_another_seed_another():
    motions = [Person(seed=seed).run(5.0) for seed in (1, 1, 2)]
    assert motions[0] == motions[1]
    assert motions[0] != motions[2]


def test_he_moves_no_faster_than_he_says():
    person = Person(speed=0.18)
    for intent in person.run(10.0)[1:]:
        assert math.hypot(*intent.velocity[:2]) <= 0.18 + 1e-6
        assert abs(intent.velocity[2]) <= 0.25 + 1e-6


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("speed", 0.0),
        ("line_spacing", math.nan),
        ("line_spacing", 1e-9),
        ("patience", math.nan),
        ("relaxed_damping", -1.0),
        ("lag", -0.1),
        ("force_noise", -0.5),
        ("relaxed_stiffness", 20.1),
        ("relax_time", 0.0),
    ],
)
def test_a_value_out_of_range_names_its_field(name, value):
    with pytest.raises(ConfigurationError) as caught:
        DemonstratorOptions(**{name: value})
    assert caught.value.field == name


@pytest.mark.parametrize("name", sorted(set(HANDS) - {"person"}))
def test_a_hand_does_the_same_whenever_it_sees_the_same(name):
    def motion():
        hand = HANDS[name]()
        return [hand.step(see(C=float(k % 100 < 60)), DT) for k in range(300)]

    assert motion() == motion()


# Other demonstrators


def unsteadiness(hand, seconds):
    depths = [-hand.step(see(), DT).position[2] for _ in range(round(seconds / DT))]
    return float(np.std(depths[-round(10.0 / DT) :]))


def test_one_who_learns_is_unsteady_at_first_and_an_expert_later():
    late = {"force_noise": 1.0, "practised": False, "learning_time": 10.0}
    early = unsteadiness(made(LearningHand, **late), 10.0)
    assert unsteadiness(made(LearningHand, **late), 60.0) < 0.7 * early


class Teaching:
    """A mistaken hand on a plane of 200 N/m, with a skill that does what it was taught in his region."""

    def __init__(self, **options):
        self.hand = made(MistakenHand, mistake_x=-0.1, mistake_y=0.0, mistake_radius=0.05, **options)
        self.x, self.y, self.depth, self.C, self.pushes = -0.1, 0.0, -0.01, 1.0, []

    def run(self, seconds, C=None):
        for _ in range(round(seconds / DT)):
            self.C = self.C if C is None else C
            force = 200.0 * max(0.0, self.depth)
            intent = self.hand.step(see(self.x, self.y, self.depth, force=force, C=self.C), DT)
            self.x, self.y = intent.position[:2]
            if self.C > 0.5:
                self.depth += (-intent.position[2] - self.depth) * DT / 0.03
            else:
                self.depth = 0.03 if math.dist((self.x, self.y), (-0.1, 0.0)) < 0.05 else 0.05
                self.pushes.append(intent.force[2])
        return 200.0 * self.depth


def test_one_who_errs_holds_a_wrong_force_in_his_region_alone():
    teaching = Teaching(mistake_share=0.6, examination=0.0, **CALM)
    forces = {True: [], False: []}
    for _ in range(1500):
        force = teaching.run(DT)
        away = math.dist((teaching.x, teaching.y), (-0.1, 0.0))
        if not 0.045 < away < 0.09:
            forces[away < 0.05].append(force)
    assert np.median(forces[True]) == pytest.approx(6.0, abs=0.5)
    assert np.median(forces[False]) == pytest.approx(10.0, abs=0.5)


def test_one_who_errs_insists_where_he_sees_it_and_teaches_it_right():
    teaching = Teaching(mistake_share=0.6, **CALM)
    teaching.run(8.0)
    assert not teaching.hand.is_aware
    teaching.run(20.0, C=0.0)
    assert teaching.hand.is_aware
    assert min(teaching.pushes) == -15.0
    teaching = Teaching(mistake_share=0.6, **CALM)
    teaching.run(8.0)
    while not teaching.pushes or min(teaching.pushes) == 0.0:
        teaching.run(DT, C=0.0)
    assert teaching.run(2.0, C=1.0) == pytest.approx(10.0, abs=1.0)
    assert math.dist((teaching.x, teaching.y), (-0.1, 0.0)) < 0.1


def test_one_who_errs_gives_up_where_nobody_lets_him_correct_himself():
    teaching = Teaching(mistake_share=0.6, **CALM)
    teaching.run(8.0)
    teaching.run(30.0, C=0.0)
    assert teaching.hand.doing is not Doing.CORRECTING
    assert teaching.pushes[-1] == 0.0


def test_a_recorded_hand_does_again_what_it_did_and_then_lets_go():
    hand = replayed()
    places = [intent and intent.position[0] for intent in (hand.step(see(), DT) for _ in range(7))]
    assert places == [0.0, 0.01, 0.02, 0.03, 0.04, None, None]


def test_a_recorded_hand_keeps_the_time_of_the_log_when_a_tick_was_skipped():
    hand = replayed()
    hand.step(see(), DT)
    assert hand.step(see(), 3.0 * DT).position[0] == pytest.approx(0.03)


@pytest.mark.parametrize(("times", "count"), [([], 0), ([0.0], 2), ([0.0, 0.0], 2)])
def test_a_recording_without_a_hand_is_refused(times, count):
    with pytest.raises(ConfigurationError) as caught:
        RecordedHand(times, [None] * count)
    assert caught.value.field == "recording"


def test_a_recorded_hand_needs_a_log():
    with pytest.raises(ConfigurationError) as caught:
        DemonstratorOptions(kind=Kind.RECORDED)
    assert caught.value.field == "recording"
