/* Layout of what crosses shared memory between a motion controller and Stillcut (iceoryx2 0.10.x).
 *
 * Services (publish-subscribe): "Stillcut/Servo" StillcutServoBatch, controller to Stillcut;
 * "Stillcut/TurretStatus" StillcutTurretStatus, controller to Stillcut, ten times a second or more;
 * "Stillcut/TurretCommand" StillcutTurretCommand, Stillcut to controller.
 * Payload type names are "stillcut.ServoBatch.v2", "stillcut.TurretStatus.v1", "stillcut.TurretCommand.v1"
 * (C++: IOX2_TYPE_NAME). Stillcut creates the services; open them, and retry while they are not there.
 * All participants run as the same user, with the same prefix and root path of the domain.
 *
 * Times are nanoseconds of the controller's own monotonic clock. Stillcut gives advice; it is not a safety
 * function. The controller keeps its own limits, ramps with its own speed limit, obeys only growing pairs
 * (epoch, sequence) of its own stream, and returns to equal pitch when its clock passes
 * based_on_t_ns + ttl_ns.
 */
#ifndef STILLCUT_H
#define STILLCUT_H

#include <stddef.h>
#include <stdint.h>

#define STILLCUT_MAX_AXES 6
#define STILLCUT_MAX_SAMPLES 32
#define STILLCUT_AXIS_NAME_BYTES 8

/* Bits of StillcutServoPoint.valid, shifted left by 3 * axis. */
#define STILLCUT_VALID_CURRENT 1u
#define STILLCUT_VALID_MOTOR 2u
#define STILLCUT_VALID_STAGE 4u
/* For the whole sample: the accelerations. */
#define STILLCUT_VALID_ACCEL (1u << 24)

/* Bits of StillcutTurretStatus.interlocks_open. */
#define STILLCUT_INTERLOCK_PERMISSIVE 1u
#define STILLCUT_INTERLOCK_OPERATOR 2u
#define STILLCUT_INTERLOCK_MACHINE 4u

enum StillcutTurretState {
    STILLCUT_TURRET_REACHED = 1,
    STILLCUT_TURRET_MOVING = 2,
    STILLCUT_TURRET_REFUSED = 3,
    STILLCUT_TURRET_LIMITED = 4,
    STILLCUT_TURRET_EXPIRED = 5
};

enum StillcutCommandKind { STILLCUT_COMMAND_OFFSET = 1, STILLCUT_COMMAND_RETURN = 2 };

typedef struct {
    double current_ref_a;
    double motor_angle_rad;
    double stage_position_m;
} StillcutServoAxis;

typedef struct {
    uint64_t sequence; /* every sample counts, from 0 */
    uint64_t t_ns;
    double spindle_angle_rad;
    double spindle_speed_rpm;
    uint32_t valid;
    uint32_t reserved; /* 0 */
    StillcutServoAxis axes[STILLCUT_MAX_AXES];
    double accel_m_s2[3]; /* of the spindle housing: x, y, z */
} StillcutServoPoint;

typedef struct {
    uint64_t stream; /* changes whenever the controller starts anew; its axes and rate stay as they are */
    double sample_rate_hz;
    uint32_t sample_count; /* 1 to 32 */
    uint32_t axis_count;   /* 1 to 6 */
    char axis_names[STILLCUT_MAX_AXES][STILLCUT_AXIS_NAME_BYTES]; /* padded with zeros */
    StillcutServoPoint points[STILLCUT_MAX_SAMPLES];              /* oldest first */
} StillcutServoBatch;

typedef struct {
    uint64_t epoch;
    uint64_t sequence;
    uint64_t based_on_t_ns;
    uint64_t issued_t_ns;
    uint64_t ttl_ns;
    uint64_t stream;
    double pitch_difference_rad;
    double offset_m[STILLCUT_MAX_AXES];
    uint32_t axis_count;
    uint32_t kind;
} StillcutTurretCommand;

typedef struct {
    uint64_t stream;   /* that of the samples: a report of another is not heard */
    uint64_t sequence; /* counts the reports: one that repeats its number is not heard */
    uint64_t t_ns;
    uint64_t acknowledged_epoch; /* 0 before the first command */
    uint64_t acknowledged_sequence;
    double offset_m[STILLCUT_MAX_AXES]; /* actual */
    uint32_t axis_count;
    uint32_t interlocks_open;
    uint32_t state;
    uint32_t reserved; /* 0 */
} StillcutTurretStatus;

#if defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L
_Static_assert(sizeof(StillcutServoPoint) == 208, "layout of StillcutServoPoint");
_Static_assert(sizeof(StillcutServoBatch) == 6728, "layout of StillcutServoBatch");
_Static_assert(offsetof(StillcutServoBatch, points) == 72, "layout of StillcutServoBatch");
_Static_assert(sizeof(StillcutTurretCommand) == 112, "layout of StillcutTurretCommand");
_Static_assert(offsetof(StillcutTurretCommand, kind) == 108, "layout of StillcutTurretCommand");
_Static_assert(sizeof(StillcutTurretStatus) == 104, "layout of StillcutTurretStatus");
_Static_assert(offsetof(StillcutTurretStatus, state) == 96, "layout of StillcutTurretStatus");
#endif

#endif
