/* @TITLE@
 *
 * Written by dpcontrol @VERSION@ (dpcontrol export): estimator, control law and supervisor of one itinerary, one call
 * for each period. C99 and <math.h>, no heap, no state but what the caller owns.
 *
 *     dpc_controller c;
 *     dpc_init(&c);
 *     every DPC_PERIOD seconds:  command = dpc_step(&c, &reading, &report);
 *
 * Any numbers may be passed to these functions. Values that are not finite or out of their range are refused and
 * reported, so that no input makes a command infinite, larger than DPC_ACCELERATION or not a number, or switches a
 * check off.
 *
 * Do not compile with -ffast-math: what is not a number must be found not to be one.
 */
#ifndef DPC_CONTROLLER_H
#define DPC_CONTROLLER_H

#ifdef __cplusplus
extern "C" {
#endif

typedef @REAL@ dpc_real;

#define DPC_VERSION 3               /* of this interface */
#define DPC_IDENTITY "@IDENTITY@"   /* of all that the controller was made from */
#define DPC_ITINERARY "@ITINERARY@"
#define DPC_LAW "@LAW@"
#define DPC_ARMS @ARMS@
#define DPC_POSITIONS @POSITIONS@   /* the arms' angles, then the cart */
#define DPC_STATES @STATES@         /* angles, rates, cart position, cart velocity */
#define DPC_EXTRAS @EXTRAS@         /* estimated in addition to the state: @EXTRA_NAMES@ */
#define DPC_MEMORY @MEMORY@
#define DPC_TICKS @TICKS@L          /* ticks of a run: 0 ... DPC_TICKS - 1; from then on its end is held */
#define DPC_RATE @RATE@             /* Hz */
#define DPC_PERIOD @PERIOD@         /* s, from one dpc_step to the next */
#define DPC_DELAY @DELAY@           /* periods from a reading to the acting of its command, as the controller believes */
#define DPC_ACCELERATION @ACCELERATION@     /* m/s^2: no command is larger */
#define DPC_FARTHEST 1e4            /* rad and m: a position beyond it is no reading; a float resolves it to 1e-3 */
#define DPC_LEAD @LEAD@             /* periods for which the command is computed ahead: commands on their way at the start */

/* What a step decides, dpc_report.outcome. From DPC_ESTIMATE_LOST on the cart is brought to rest. */
enum dpc_outcome {
    DPC_GO_ON = 0,
    DPC_RESTART = 1,        /* the estimator restarts from the encoders */
    DPC_RESYNCHRONISE = 2,  /* an angle is far from the reference; nothing is done about it */
    DPC_HOLD = 3,           /* not used here */
    DPC_ESTIMATE_LOST = 4,
    DPC_SILENT = 5,         /* a position was not measured for too long */
    DPC_CART = 6,           /* the cart must brake now to stay on its track */
    DPC_TRACKING_LOST = 7,
    DPC_STUCK = 8,          /* a sensor repeats itself: dpc_report.sensor */
    DPC_SWITCH = 9,         /* a limit switch answered */
    DPC_FALLEN = 10,        /* the arms have left the reference, and the cart that runs after them must brake */
    DPC_DRIVE_OFF = 11,     /* the cart does not follow the commands */
    DPC_DRIVE_REVERSED = 12 /* the cart moves against the commands */
};

/* What dpc_status tells. */
enum dpc_run {
    DPC_RUNNING = 0,   /* the reference is followed */
    DPC_FINISHED = 1,  /* all its ticks are done: its end is held until somebody stops */
    DPC_BRAKING = 2,   /* the supervisor brings the cart to rest; there is no way back but dpc_init */
    DPC_AT_REST = 3    /* it has; the command is 0 and the drive may be switched off */
};

/* dpc_report.mode */
enum dpc_mode { DPC_TRACKING = 1, DPC_HOLDING = 2, DPC_SATURATED = 4, DPC_ABORTED = 6 };

/* A controller's memory, owned by the caller. What is in it is the controller's own; copies are independent. */
typedef struct {
    dpc_real memory[DPC_MEMORY];
    long tick; /* steps done */
} dpc_controller;

/* What was measured at a tick. */
typedef struct {
    double positions[DPC_POSITIONS];      /* rad: each arm's own angle from hanging, counter-clockwise positive, whole
                                             turns counted; then m: the cart from the middle of its track. Double also
                                             where dpc_real is float, which would round a count after some turns. */
    unsigned char present[DPC_POSITIONS]; /* 1 where measured, 0 where not: that position may then be anything. A
                                             position that is not a number, or beyond DPC_FARTHEST, is not measured. */
    int limit_switch;                     /* 1 while a limit switch is touched */
    double age;                           /* s from the reading to this step, at most a period; 0 if not known, and
                                             any other value counts as not known */
} dpc_reading;

/* What a step tells. */
typedef struct {
    dpc_real command;                 /* m/s^2, to the drive: the cart's acceleration for one period */
    int outcome;                      /* enum dpc_outcome, of this step */
    int stopped_by;                   /* the outcome that ended the run, DPC_GO_ON while it goes on */
    int stop;                         /* 1 while the cart is brought to rest; the command does it */
    int done;                         /* 1 once it has stood for 50 ms */
    int mode;                         /* enum dpc_mode */
    int saturated;                    /* 1 where the command was cut, or the cart is at its greatest velocity */
    int newly_cut;                    /* 1 where that begins */
    int used;                         /* positions that this step's estimate is of */
    int refused;                      /* values of this step's reading that were refused: present positions and age */
    int sensor;                       /* number of a stuck sensor, from 1: the arms' encoders, then the cart's scale */
    long repeats;                     /* steps for which it has given the same reading */
    int untrusted;                      /* number of an extra found beyond trust for the first time, from 1; else 0 */
    dpc_real state[DPC_STATES];       /* estimated at this tick: rad, rad/s, m, m/s */
    dpc_real sigmas[DPC_STATES + DPC_EXTRAS]; /* standard deviations of state and extra */
#if DPC_EXTRAS > 0
    dpc_real extra[DPC_EXTRAS];       /* estimated: @EXTRA_NAMES@ */
#endif
    dpc_real reference[DPC_STATES];   /* of this tick: rad, rad/s, m, m/s */
    dpc_real ahead[DPC_STATES];       /* the state expected when this command acts */
    dpc_real wish;                    /* m/s^2, before limits: feedforward + feedback */
    dpc_real feedforward, feedback;   /* m/s^2 */
    dpc_real acting;                  /* m/s^2 that acts in the coming period, of commands given before */
    dpc_real nis;                     /* normalised innovation squared of this step, about `used` in the mean */
    dpc_real mean_nis;                /* for each position, mean over 0.2 s: compared with a bound of @LOST_ESTIMATE@ */
    dpc_real error;                   /* rad: largest angle's distance from the reference, mean over 1 s; @LOST_TRACKING@ */
    dpc_real silent;                  /* s since the position that is missing longest was measured; bound @MISSING@ s */
} dpc_report;

/* What the library was made for, to check a binary against what it is to be used with. */
typedef struct {
    int version, real_bytes, controller_bytes, reading_bytes, report_bytes;
    int arms, states, extras, lead;
    long ticks;
    double rate, delay;
    const char *itinerary, *law, *identity;
} dpc_description;

/* Begin a run: the arms as dpc_reference(0) has them, the commands of dpc_queued on their way. */
void dpc_init(dpc_controller *controller);

/* Do one tick and return its command in m/s^2; report may be a null pointer. */
dpc_real dpc_step(dpc_controller *controller, const dpc_reading *reading, dpc_report *report);

/* State the command that the drive received, if it is not the one of the last step, for example after a limiter of the
 * target. Otherwise the next estimate assumes a motion that the cart did not make. Return 1. A command that is not a
 * number or is larger than DPC_ACCELERATION is refused: then return 0 and keep the command of the last step. */
int dpc_sent(dpc_controller *controller, dpc_real command);

/* enum dpc_run, after the last step. */
int dpc_status(const dpc_controller *controller);

/* Command, m/s^2, to act in period k = 0 ... DPC_LEAD - 1 of a run, before the first step's own acts; 0 for other k. */
dpc_real dpc_queued(long k);

/* The reference's state at a tick; before the first and after the last those of the first and last. */
void dpc_reference(long tick, dpc_real state[DPC_STATES]);

const dpc_description *dpc_describe(void);

#ifdef __cplusplus
}
#endif

#endif
