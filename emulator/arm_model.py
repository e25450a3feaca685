"""The emulated arm: its state, its constants and the one compiled call that runs it."""

import math
import random
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from emulator import layout
from emulator.compilation import interpreted
from emulator.effect_table import EffectTable
from emulator.kernels import advance
from emulator.noise import seed_random
from emulator.parameters import ArmParameters
from hm_driver.geometry import joint_to_cartesian

Vector = tuple[float, float, float]
Floats = npt.NDArray[np.float64]


class Truth(NamedTuple):
    """What only a simulation can know, in the device's frame."""

    time_s: float
    tip_position: Vector
    """Where the handle really is [m]."""
    tip_velocity: Vector
    """How it really moves [m/s]."""
    hand_force: Vector
    """Force of the hand on the handle [N]."""
    contact_force: Vector
    """Force of the shapes on the virtual mass [N]."""
    effect_force: Vector
    """Force of the other effects on the virtual mass [N]."""


class ArmModel:
    """Arm, controller, sensors and hand; deterministic for a seed, without clock or I/O.

    Args:
        parameters: Constants of the arm.
        seed: Seed of the force sensor's offset, noise and drift.
        compiled: Run the machine code; plain Python with the same result is there to be measured.
    """

    def __init__(self, parameters: ArmParameters, *, seed: int, compiled: bool = True) -> None:
        self.parameters = parameters
        self.effects = EffectTable()
        self.state: Floats = np.zeros(layout.S_SIZE)
        self.params: Floats = pack_parameters(parameters)
        self.outputs: Floats = np.zeros(layout.O_SIZE)
        self._advance: Callable[..., int] = advance if compiled else interpreted(advance)
        self._start(seed)

    def warm_up(self) -> None:
        """Compile the kernels, or load their stored code; changes nothing but refreshes the outputs."""
        self.step(0)

    def step(self, n: int) -> int:
        """Run ``n`` steps of 1/2500 s, or fewer where a guard trips, and refresh the outputs.

        Returns:
            The number of steps run.
        """
        table = self.effects
        return self._advance(
            self.state, self.params, table.flat, table.active, table.n_active, self.outputs, n
        )

    def set_guards(self, *, speed: float, force: float, following_error: float) -> None:
        """Stop stepping where the powered arm is beyond a limit [m/s, N, m]; at first there is none."""
        self.params[layout.P_GUARD_SPEED] = speed
        self.params[layout.P_GUARD_FORCE] = force
        self.params[layout.P_GUARD_FOLLOWING] = following_error

    @property
    def step_count(self) -> int:
        """Steps since the start."""
        return int(self.state[layout.S_STEPS])

    @property
    def time_s(self) -> float:
        """Time since the start [s]."""
        return float(self.state[layout.S_STEPS] * self.params[layout.P_STEP])

    @property
    def inertia(self) -> float:
        """Virtual mass [kg]; the caller sees to the device's minimum."""
        return float(self.state[layout.S_INERTIA])

    @inertia.setter
    def inertia(self, value: float) -> None:
        self.state[layout.S_INERTIA] = value

    @property
    def coulomb_friction(self) -> float:
        """Dry friction of the virtual mass [N]."""
        return float(self.state[layout.S_COULOMB_FRICTION])

    @coulomb_friction.setter
    def coulomb_friction(self, value: float) -> None:
        self.state[layout.S_COULOMB_FRICTION] = value

    def set_render(self, *, powered: bool, effects: bool, force_sensor: bool) -> None:
        """Choose what the arm does; ends a drive.

        Unpowered it moves freely with its own mass and friction. Powered with neither effects nor force
        sensor it brakes and holds its place. Otherwise the virtual mass moves by what is rendered.
        """
        mode = layout.MODE_UNPOWERED
        if powered:
            mode = layout.MODE_RENDER if effects or force_sensor else layout.MODE_HOLD
        self.state[layout.S_MODE] = mode
        self.state[layout.S_USE_EFFECTS] = float(effects)
        self.state[layout.S_USE_SENSOR] = float(force_sensor)

    def drive_to(self, r: float, phi: float, z: float, *, speed: float = 1.0) -> None:
        """Drive the joints to a place [m, rad, m] within the end stops, at a share of the homing speed."""
        for i, target in enumerate((r, phi, z)):
            low, high = self.parameters.joint_min[i], self.parameters.joint_max[i]
            self.state[layout.S_DRIVE_TARGET + i] = max(low, min(high, target))
        self.state[layout.S_DRIVE_SPEED] = speed
        self.state[layout.S_MODE] = layout.MODE_DRIVE

    def is_settled(self, *, tolerance: float = 2e-4) -> bool:
        """Whether set-points and measured joints are within the tolerance [m, rad] of a drive's target."""
        target = self.state[layout.S_DRIVE_TARGET : layout.S_DRIVE_TARGET + 3]
        places = (layout.S_SET_JOINT, layout.S_ENCODER)
        return all(bool(np.all(np.abs(self.state[i : i + 3] - target) < tolerance)) for i in places)

    def calibrate_force_sensor(self) -> None:
        """Take the sensor's present mean reading as zero, a hand that pushes included."""
        mean = self.state[layout.S_SENSOR_MEAN : layout.S_SENSOR_MEAN + 3]
        self.state[layout.S_SENSOR_TARE : layout.S_SENSOR_TARE + 3] = mean

    def set_hand(
        self,
        position: Sequence[float],
        velocity: Sequence[float],
        stiffness: Sequence[float],
        damping: Sequence[float],
        force: Sequence[float],
    ) -> None:
        """Hold the handle with an impedance, Cartesian, for the hand's intended motion.

        The force on the handle is K (p_h - p) + B (v_h - v) + F. The intended position moves on with its
        velocity until the next update, for 20 ms at most.

        Args:
            position: Intended position p_h [m].
            velocity: Its velocity v_h [m/s].
            stiffness: K, an axis each [N/m].
            damping: B, an axis each [N·s/m].
            force: Additional force F [N].
        """
        state = self.state
        for i in range(3):
            state[layout.S_HAND_POSITION + i] = position[i]
            state[layout.S_HAND_VELOCITY + i] = velocity[i]
            state[layout.S_HAND_STIFFNESS + i] = stiffness[i]
            state[layout.S_HAND_DAMPING + i] = damping[i]
            state[layout.S_HAND_PUSH + i] = force[i]
        state[layout.S_HAND_AGE] = 0.0
        state[layout.S_HAND_GAIN] = 1.0
        state[layout.S_HAND_RELEASED] = 0.0

    def release_hand(self) -> None:
        """Let go of the handle: the impedance fades to nothing within 50 ms."""
        self.state[layout.S_HAND_RELEASED] = 1.0

    def set_sensor_fault(
        self, *, bias: Vector = (0.0, 0.0, 0.0), noise: float = 1.0, stuck: bool = False
    ) -> None:
        """Make the force sensor biased [N], noisier by a factor, or stuck; the defaults make it whole."""
        self.state[layout.S_FAULT_BIAS : layout.S_FAULT_BIAS + 3] = bias
        self.state[layout.S_FAULT_NOISE] = noise
        self.state[layout.S_FAULT_STUCK] = float(stuck)

    def set_encoder_offset(self, offset: Vector) -> None:
        """Let the encoders read too much by r [m], phi [rad], z [m], as after a jump."""
        self.state[layout.S_FAULT_ENCODER : layout.S_FAULT_ENCODER + 3] = offset

    def output(self, start: int) -> Vector:
        """Three numbers of the outputs, from one of the ``O_`` constants of ``emulator.layout``."""
        x, y, z = self.outputs[start : start + 3].tolist()
        return x, y, z

    def truth(self) -> Truth:
        """What only a simulation can know."""
        return Truth(
            time_s=self.time_s,
            tip_position=self.output(layout.O_TIP_POSITION),
            tip_velocity=self.output(layout.O_TIP_VELOCITY),
            hand_force=self.output(layout.O_HAND_FORCE),
            contact_force=self.output(layout.O_CONTACT_FORCE),
            effect_force=self.output(layout.O_EFFECT_FORCE),
        )

    def place_at(self, x: float, y: float, z: float) -> None:
        """Put arm and virtual mass at rest at a position [m], as if it had always been there."""
        radius = math.hypot(self.parameters.r0 + x, y)
        self._place((radius - self.parameters.r0, math.atan2(y, self.parameters.r0 + x), z))

    def _start(self, seed: int) -> None:
        state = self.state
        seed_random(state, seed)
        source = random.Random(seed)
        for i in range(3):
            offset = source.gauss(0.0, self.parameters.sensor_offset)
            state[layout.S_SENSOR_OFFSET + i] = state[layout.S_SENSOR_MEAN + i] = offset
        state[layout.S_INERTIA] = self.parameters.inertia
        state[layout.S_COULOMB_FRICTION] = self.parameters.coulomb_friction
        state[layout.S_DRIVE_SPEED] = 1.0
        state[layout.S_FAULT_NOISE] = 1.0
        self._place(self.parameters.initial)

    def _place(self, joints: Vector) -> None:
        state = self.state
        tip = joint_to_cartesian(*joints, self.parameters.r0)
        for i in range(3):
            resolution = self.parameters.encoder_resolution[i]
            state[layout.S_JOINT + i] = state[layout.S_SET_JOINT + i] = joints[i]
            state[layout.S_ENCODER + i] = math.floor(joints[i] / resolution + 0.5) * resolution
            state[layout.S_POSITION + i] = state[layout.S_TIP + i] = tip[i]
            for start in _AT_REST:
                state[start + i] = 0.0
        state[layout.S_COSINE], state[layout.S_SINE] = math.cos(joints[1]), math.sin(joints[1])
        self.outputs[layout.O_TIP_POSITION : layout.O_TIP_POSITION + 3] = tip


_AT_REST = (
    layout.S_VELOCITY,
    layout.S_ACCELERATION,
    layout.S_SET_JOINT_VELOCITY,
    layout.S_SET_JOINT_ACCELERATION,
    layout.S_JOINT_VELOCITY,
    layout.S_DRIVE,
    layout.S_INTEGRAL,
    layout.S_SERVO_VELOCITY,
    layout.S_REPORTED_VELOCITY,
    layout.S_TIP_VELOCITY,
)


def pack_parameters(parameters: ArmParameters) -> Floats:
    """The constants in the order that the kernels read, with filter gains computed for the step."""
    step = 1.0 / parameters.rate_hz
    params = np.zeros(layout.P_SIZE)

    def gain(frequency_hz: float) -> float:
        return 1.0 - math.exp(-2.0 * math.pi * frequency_hz * step)

    omega = 2.0 * math.pi * parameters.servo_frequency_hz
    scalars = {
        layout.P_STEP: step,
        layout.P_RATE: parameters.rate_hz,
        layout.P_R0: parameters.r0,
        layout.P_STOP_ZONE: parameters.end_stop_zone,
        layout.P_STOP_STIFFNESS: parameters.end_stop_stiffness,
        layout.P_STOP_DAMPING_RATIO: parameters.end_stop_damping_ratio,
        layout.P_STOP_MARGIN: parameters.end_stop_margin,
        layout.P_ACCELERATION_MAX: parameters.acceleration_max,
        layout.P_STOP_DECELERATION: parameters.stop_deceleration,
        layout.P_HOMING_RATE: parameters.homing_rate,
        layout.P_MASS_R: parameters.mass_r,
        layout.P_MASS_Z: parameters.mass_z,
        layout.P_COLUMN_INERTIA: parameters.column_inertia,
        layout.P_ARM_MASS: parameters.arm_mass,
        layout.P_FRICTION_COMPENSATION: parameters.friction_compensation,
        layout.P_DRIVE_GAIN: gain(parameters.drive_bandwidth_hz),
        layout.P_SERVO_KP: omega * omega,
        layout.P_SERVO_KD: 2.0 * parameters.servo_damping_ratio * omega,
        layout.P_SERVO_KI: omega * omega * parameters.servo_integral_rate,
        layout.P_SERVO_FILTER: gain(parameters.servo_velocity_filter_hz),
        layout.P_REPORTED_FILTER: gain(parameters.encoder_velocity_filter_hz),
        layout.P_SENSOR_NOISE: parameters.sensor_noise,
        layout.P_SENSOR_RESOLUTION: parameters.sensor_resolution,
        layout.P_SENSOR_PER_RESOLUTION: 1.0 / parameters.sensor_resolution,
        layout.P_SENSOR_DRIFT: parameters.sensor_drift * math.sqrt(3.0 * step),
        layout.P_SENSOR_MEAN_GAIN: gain(parameters.sensor_calibration_filter_hz),
        layout.P_SENSOR_RANGE: parameters.sensor_range,
        layout.P_HAND_HOLD: parameters.hand_hold_s,
        layout.P_HAND_FADE: parameters.hand_fade_s,
        layout.P_SHAKER_SWEEP: parameters.shaker_sweep_s,
        layout.P_SHAKER_RAMP: parameters.shaker_ramp_s,
        layout.P_GUARD_SPEED: math.inf,
        layout.P_GUARD_FORCE: math.inf,
        layout.P_GUARD_FOLLOWING: math.inf,
    }
    speed, integral = parameters.friction_compensation_speed, parameters.servo_integral_max
    first, second, third = parameters.encoder_resolution
    vectors = {
        layout.P_FRICTION_SPEED: (speed, speed / parameters.r0, speed),
        layout.P_SERVO_INTEGRAL_MAX: (integral, integral / parameters.r0, integral),
        layout.P_PER_RESOLUTION: (1.0 / first, 1.0 / second, 1.0 / third),
        layout.P_JOINT_MIN: parameters.joint_min,
        layout.P_JOINT_MAX: parameters.joint_max,
        layout.P_VELOCITY_MAX: parameters.velocity_max,
        layout.P_HOMING_SPEED: parameters.homing_speed,
        layout.P_HOMING_ACCELERATION: parameters.homing_acceleration,
        layout.P_COULOMB: parameters.friction_coulomb,
        layout.P_VISCOUS: parameters.friction_viscous,
        layout.P_DRIVE_LIMIT: parameters.drive_limit,
        layout.P_STRUCTURE: parameters.structure_stiffness,
        layout.P_RESOLUTION: parameters.encoder_resolution,
    }
    for index, value in scalars.items():
        params[index] = value
    for index, vector in vectors.items():
        params[index : index + 3] = vector
    return params
