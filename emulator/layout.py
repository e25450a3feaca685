"""Where each number of the arm's model lives in its flat arrays.

The kernels of the emulator hold no objects: they read and write four arrays of floats, the *state*
(``S_``), the *parameters* (``P_``, constant), the *effects* (``E_``, one row of ``E_SIZE`` numbers an
effect) and the *outputs* (``O_``). A constant here is the index of the first number; vectors take three, in
the order x, y, z or, for joints, r, phi, z.
"""

from typing import Final

# State: the virtual model (outer loop).
S_MODE: Final = 0
S_USE_EFFECTS: Final = 1
S_USE_SENSOR: Final = 2
S_STEPS: Final = 3
S_INERTIA: Final = 4
S_COULOMB_FRICTION: Final = 5
S_POSITION: Final = 6
S_VELOCITY: Final = 9
S_ACCELERATION: Final = 12
S_SET_JOINT: Final = 15
S_SET_JOINT_VELOCITY: Final = 18
S_SET_JOINT_ACCELERATION: Final = 21
S_DRIVE_TARGET: Final = 24
S_DRIVE_SPEED: Final = 27
S_EFFECT_FORCE: Final = 28
S_CONTACT_FORCE: Final = 31
S_VELOCITY_LIMITED: Final = 34
S_ACCELERATION_LIMITED: Final = 35
S_AT_END_STOP: Final = 36
S_LIMITED_STEPS: Final = 37
S_DRIVE_LIMITED: Final = 38
# State: the real arm (inner loop).
S_JOINT: Final = 40
S_JOINT_VELOCITY: Final = 43
S_DRIVE: Final = 46
S_INTEGRAL: Final = 49
S_ENCODER: Final = 52
S_SERVO_VELOCITY: Final = 55
S_REPORTED_VELOCITY: Final = 58
S_TIP: Final = 61
S_TIP_VELOCITY: Final = 64
# State: the hand.
S_HAND_FORCE: Final = 67
S_HAND_POSITION: Final = 70
S_HAND_VELOCITY: Final = 73
S_HAND_STIFFNESS: Final = 76
S_HAND_DAMPING: Final = 79
S_HAND_PUSH: Final = 82
S_HAND_AGE: Final = 85
S_HAND_GAIN: Final = 86
S_HAND_RELEASED: Final = 87
# State: the force sensor, and what a fault does to the sensors.
S_SENSOR_OFFSET: Final = 88
S_SENSOR_TARE: Final = 91
S_SENSOR_RAW: Final = 94
S_SENSOR_MEAN: Final = 97
S_SENSOR_FORCE: Final = 100
S_FAULT_BIAS: Final = 103
S_FAULT_STUCK: Final = 106
S_FAULT_NOISE: Final = 107
S_FAULT_ENCODER: Final = 108
S_RANDOM: Final = 111
# State: scratch of one step.
S_FORCE: Final = 117
S_MATRIX: Final = 120
S_INVERSE: Final = 126
S_NORMAL: Final = 132
S_MASS: Final = 135
S_COUPLING: Final = 138
S_LOAD: Final = 141
S_COSINE: Final = 144
S_SINE: Final = 145
S_AXIS: Final = 146
S_SIZE: Final = 147

MODE_UNPOWERED: Final = 0.0
MODE_HOLD: Final = 1.0
MODE_RENDER: Final = 2.0
MODE_DRIVE: Final = 3.0

# Parameters: constants of one arm, some of them computed once from those of the file.
P_STEP: Final = 0
P_RATE: Final = 1
P_R0: Final = 2
P_JOINT_MIN: Final = 3
P_JOINT_MAX: Final = 6
P_STOP_ZONE: Final = 9
P_STOP_STIFFNESS: Final = 10
P_STOP_DAMPING_RATIO: Final = 11
P_STOP_MARGIN: Final = 12
P_VELOCITY_MAX: Final = 13
P_ACCELERATION_MAX: Final = 16
P_STOP_DECELERATION: Final = 17
P_HOMING_SPEED: Final = 18
P_HOMING_ACCELERATION: Final = 21
P_HOMING_RATE: Final = 24
P_MASS_R: Final = 25
P_MASS_Z: Final = 26
P_COLUMN_INERTIA: Final = 27
P_ARM_MASS: Final = 28
P_COULOMB: Final = 29
P_VISCOUS: Final = 32
P_FRICTION_COMPENSATION: Final = 35
P_FRICTION_SPEED: Final = 36
P_DRIVE_GAIN: Final = 39
P_DRIVE_LIMIT: Final = 40
P_SERVO_KP: Final = 43
P_SERVO_KD: Final = 44
P_SERVO_KI: Final = 45
P_SERVO_INTEGRAL_MAX: Final = 46
P_STRUCTURE: Final = 49
P_RESOLUTION: Final = 52
P_PER_RESOLUTION: Final = 55
P_SERVO_FILTER: Final = 58
P_REPORTED_FILTER: Final = 59
P_SENSOR_NOISE: Final = 60
P_SENSOR_RESOLUTION: Final = 61
P_SENSOR_PER_RESOLUTION: Final = 62
P_SENSOR_DRIFT: Final = 63
P_SENSOR_MEAN_GAIN: Final = 64
P_SENSOR_RANGE: Final = 65
P_HAND_HOLD: Final = 66
P_HAND_FADE: Final = 67
P_SHAKER_SWEEP: Final = 68
P_SHAKER_RAMP: Final = 69
P_GUARD_SPEED: Final = 70
P_GUARD_FORCE: Final = 71
P_GUARD_FOLLOWING: Final = 72
P_SIZE: Final = 73

# Effects: one row each. What a kind does not use stays at its default.
E_KIND: Final = 0
E_ENABLED: Final = 1
E_POSITION: Final = 2
E_VELOCITY: Final = 5
E_ATTITUDE: Final = 8
E_STIFFNESS: Final = 12
E_DAMPING_RATIO: Final = 13
E_DEADBAND: Final = 14
E_DIRECTION: Final = 15
E_HAS_DIRECTION: Final = 18
E_MAX_FORCE: Final = 19
E_DAMPING_GLOBAL: Final = 20
E_DAMPING: Final = 21
E_BIAS: Final = 24
E_FREQUENCY_1: Final = 27
E_FREQUENCY_2: Final = 28
E_POSITION_MAX: Final = 29
E_VELOCITY_MAX: Final = 30
E_ACCELERATION_MAX: Final = 31
E_SIZE_XYZ: Final = 32
E_RADIUS: Final = 35
E_LENGTH: Final = 36
E_RING_RADIUS: Final = 37
E_TUBE_RADIUS: Final = 38
E_NORMAL: Final = 39
E_NO_PULL: Final = 42
E_TANGENTIAL_DAMPING: Final = 43
E_DAMPING_FORCE_MAX: Final = 44
E_FRICTION: Final = 45
E_EJECTION_VELOCITY_MAX: Final = 46
E_EJECTION_DAMPING: Final = 47
E_OUTWARD_FORCE_MAX: Final = 48
E_POWER_MAX: Final = 49
E_TIME: Final = 50
E_PHASE: Final = 51
E_GRIP: Final = 52
E_GRIP_NORMAL: Final = 53
E_SIZE: Final = 56
ROW_MAX: Final = 1000000

KIND_FREE: Final = 0.0
KIND_SPRING: Final = 1.0
KIND_DAMPER: Final = 2.0
KIND_BIAS_FORCE: Final = 3.0
KIND_SHAKER: Final = 4.0
KIND_BLOCK: Final = 5.0
KIND_SPHERE: Final = 6.0
KIND_FLAT_PLANE: Final = 7.0
KIND_CYLINDER: Final = 8.0
KIND_TORUS: Final = 9.0

# Outputs: what the device and the world can be asked, refreshed at the end of every call of ``advance``.
O_MEASURED_POSITION: Final = 0
O_MEASURED_VELOCITY: Final = 3
O_MEASURED_FORCE: Final = 6
O_MODEL_POSITION: Final = 9
O_MODEL_VELOCITY: Final = 12
O_MODEL_ACCELERATION: Final = 15
O_MEASURED_JOINT: Final = 18
O_MODEL_JOINT: Final = 21
O_MODEL_JOINT_VELOCITY: Final = 24
O_MODEL_JOINT_ACCELERATION: Final = 27
O_MEASURED_JOINT_FORCE: Final = 30
O_TIP_POSITION: Final = 33
O_TIP_VELOCITY: Final = 36
O_HAND_FORCE: Final = 39
O_CONTACT_FORCE: Final = 42
O_EFFECT_FORCE: Final = 45
O_TIME: Final = 48
O_VELOCITY_LIMITED: Final = 49
O_ACCELERATION_LIMITED: Final = 50
O_AT_END_STOP: Final = 51
O_LIMITED_STEPS: Final = 52
O_DRIVE_LIMITED: Final = 53
O_GUARD: Final = 54
O_SIZE: Final = 55
