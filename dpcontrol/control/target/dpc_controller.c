/* @TITLE@
 *
 * Written by dpcontrol @VERSION@ (dpcontrol export). The tick itself is the expression that dpcontrol's own loop runs,
 * made C by CasADi with this itinerary's numbers in it: change the itinerary, not this file.
 */
#include "dpc_controller.h"
#include "dpc_tables.h"

#include <limits.h>
#include <math.h>

#ifdef __FAST_MATH__
#error "compile without -ffast-math: what is not a number must be found not to be one"
#endif

/* Whether the state is kept as the sum of two numbers, origin and z: what is known of it is finer than a float. */
#define DPC_SPLIT @SPLIT@

/* Where the tick's results stand: the memory for the next, then the report. */
enum {
@PLACES@
    AT_END = @RESULTS@
};

@HELPERS@

/* memory[DPC_MEMORY], measured, present and offset[DPC_POSITIONS], limit_switch, age; acts[DPC_VALUES]: the table's
 * values when the command acts; now[DPC_STATES]: the reference's state at this tick; out[AT_END]. */
static void dpc_tick(const dpc_real *memory, const dpc_real *measured, const dpc_real *present, const dpc_real *offset,
                     const dpc_real *limit_switch, const dpc_real *age, const dpc_real *acts, const dpc_real *now,
                     dpc_real *out)
{
@TICK@
    (void)offset;
    (void)acts;
    (void)now;
}

/* The first values of a tick, by polynomials over its piece; those of the first or last tick before or after them. */
static void look_up(long tick, int count, dpc_real *values)
{
    const long last = dpc_pieces[DPC_PIECES] - 1, at = tick < 0 ? 0 : tick < last ? tick : last;
    long piece = 0, end = DPC_PIECES, steps;
    dpc_real basis[DPC_LARGE + DPC_SMALL], place;
    int i, k;

    while (end - piece > 1) {
        const long middle = piece + (end - piece) / 2;

        if (dpc_pieces[middle] <= at)
            piece = middle;
        else
            end = middle;
    }
    steps = dpc_pieces[piece + 1] - dpc_pieces[piece] - 1;
    place = (dpc_real)(2 * (at - dpc_pieces[piece]) - steps) / (dpc_real)(steps > 0 ? steps : 1);
    basis[0] = 1;
    basis[1] = place;
    for (k = 2; k < DPC_LARGE + DPC_SMALL; k++)
        basis[k] = 2 * place * basis[k - 1] - basis[k - 2];
    for (i = 0; i < count; i++) {
        values[i] = 0;
        for (k = DPC_SMALL; k-- > 0;)
            values[i] += basis[DPC_LARGE + k] * (dpc_real)dpc_small[piece][k][i];
        for (k = DPC_LARGE; k-- > 0;)
            values[i] += basis[k] * dpc_large[piece][k][i];
    }
}

void dpc_init(dpc_controller *controller)
{
    int i;

    for (i = 0; i < DPC_MEMORY; i++)
        controller->memory[i] = dpc_start[i];
    controller->tick = 0;
}

dpc_real dpc_step(dpc_controller *controller, const dpc_reading *reading, dpc_report *report)
{
    dpc_real out[AT_END], measured[DPC_POSITIONS], present[DPC_POSITIONS], offset[DPC_POSITIONS], limit_switch, age;
    dpc_real acts[DPC_VALUES], now[DPC_STATES];
    const long tick = controller->tick < DPC_TICKS ? controller->tick : DPC_TICKS;
    const int aged = reading->age >= 0 && reading->age <= DPC_PERIOD;
    int i, refused = !aged;

    for (i = 0; i < DPC_POSITIONS; i++) {
        const int valid = fabs(reading->positions[i]) <= DPC_FARTHEST;
        const double position = valid ? reading->positions[i] : 0;

        measured[i] = (dpc_real)position;
        present[i] = reading->present[i] && valid ? 1 : 0;
        refused += reading->present[i] && !valid;
#if DPC_SPLIT
        offset[i] = (dpc_real)(position - (double)controller->memory[AT_ORIGIN + (i < DPC_ARMS ? i : 2 * DPC_ARMS)]);
#else
        offset[i] = measured[i];
#endif
    }
    limit_switch = reading->limit_switch ? 1 : 0;
    age = aged ? (dpc_real)reading->age : 0;
    look_up(tick + DPC_LEAD, DPC_VALUES, acts);
    look_up(tick, DPC_STATES, now);
    dpc_tick(controller->memory, measured, present, offset, &limit_switch, &age, acts, now, out);
    for (i = 0; i < DPC_MEMORY; i++)
        controller->memory[i] = out[i];
#if DPC_SPLIT
    for (i = 0; i < DPC_STATES; i++) {
        dpc_real *origin = &controller->memory[AT_ORIGIN + i], *rest = &controller->memory[AT_Z + i];
        const dpc_real sum = *origin + *rest, added = sum - *origin;

        *rest = (*origin - (sum - added)) + (*rest - added);
        *origin = sum;
    }
#endif
    if (controller->tick < LONG_MAX)
        controller->tick++;
    if (report) {
        report->command = out[AT_COMMAND];
        report->outcome = (int)out[AT_OUTCOME];
        report->stopped_by = (int)out[AT_STOPPED];
        report->stop = (int)out[AT_STOP];
        report->done = (int)out[AT_DONE];
        report->mode = (int)out[AT_MODE];
        report->saturated = (int)out[AT_SATURATED];
        report->newly_cut = (int)out[AT_NEWLY_CUT];
        report->used = (int)out[AT_USED];
        report->refused = refused;
        report->sensor = (int)out[AT_SENSOR];
        report->repeats = (long)out[AT_REPEATS];
        report->untrusted = (int)out[AT_UNTRUSTED];
        for (i = 0; i < DPC_STATES; i++) {
            report->state[i] = out[AT_STATE + i];
            report->reference[i] = now[i];
            report->ahead[i] = out[AT_AHEAD + i];
        }
        for (i = 0; i < DPC_STATES + DPC_EXTRAS; i++)
            report->sigmas[i] = out[AT_SIGMAS + i];
#if DPC_EXTRAS > 0
        for (i = 0; i < DPC_EXTRAS; i++)
            report->extra[i] = out[AT_EXTRA + i];
#endif
        report->wish = out[AT_WISH];
        report->feedforward = out[AT_FEEDFORWARD];
        report->feedback = out[AT_FEEDBACK];
        report->acting = out[AT_ACTING];
        report->nis = out[AT_NIS];
        report->mean_nis = out[AT_MEAN_NIS];
        report->error = out[AT_ERROR];
        report->silent = out[AT_SILENT];
    }
    return out[AT_COMMAND];
}

int dpc_sent(dpc_controller *controller, dpc_real command)
{
    dpc_real *last = &controller->memory[AT_SENT_LAST];
    const dpc_real most = (dpc_real)DPC_ACCELERATION;
    dpc_real more;

    if (!(command >= -most && command <= most))
        return 0;
    more = (command - *last) * @PERIOD_REAL@;
    controller->memory[AT_VELOCITY] += more;
    controller->memory[AT_HEADING] += more;
    *last = command;
    return 1;
}

int dpc_status(const dpc_controller *controller)
{
    if (controller->memory[AT_STOPPED] > 0)
        return controller->memory[AT_STILL] > @SETTLING@ ? DPC_AT_REST : DPC_BRAKING;
    return controller->tick < DPC_TICKS ? DPC_RUNNING : DPC_FINISHED;
}

dpc_real dpc_queued(long k)
{
    return k >= 0 && k < DPC_LEAD ? dpc_first_commands[k] : 0;
}

void dpc_reference(long tick, dpc_real state[DPC_STATES])
{
    look_up(tick, DPC_STATES, state);
}

const dpc_description *dpc_describe(void)
{
    static const dpc_description description = {
        DPC_VERSION, (int)sizeof(dpc_real), (int)sizeof(dpc_controller), (int)sizeof(dpc_reading),
        (int)sizeof(dpc_report), DPC_ARMS, DPC_STATES, DPC_EXTRAS, DPC_LEAD, DPC_TICKS, DPC_RATE, DPC_DELAY,
        DPC_ITINERARY, DPC_LAW, DPC_IDENTITY
    };

    return &description;
}
