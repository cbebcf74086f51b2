/* The controller as a co-simulation unit of FMI 2.0; modelDescription.xml names its variables in the order used here.
 *
 * A step of DPC_PERIOD does one tick with the inputs as they were set, so that the command answers them from the step's
 * end on. A step of several whole periods does a tick in each, all with the inputs of its beginning. Shorter steps are
 * allowed where a whole number of them makes a period: outputs stay in between.
 */
#include "dpc_controller.h"

#include <limits.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

/* What is used of fmi2Functions.h, where a tool has not put it before this file. */
#ifndef fmi2Functions_h
typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;
#endif
#if defined _WIN32
#define EXPORT __declspec(dllexport)
#elif defined __GNUC__
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif

#ifdef __GNUC__
/* The standard's functions have more arguments than this unit looks at. */
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

#define GUID "@GUID@"
#define SAME_TIME (1e-6 * DPC_PERIOD)

/* Variables of each type: inputs first. */
enum {
    REAL_INPUTS = DPC_POSITIONS,
    REALS = REAL_INPUTS + 9 + 4 * DPC_STATES + 2 * DPC_EXTRAS,
    INTEGER_INPUTS = 1,
    INTEGERS = INTEGER_INPUTS + 9,
    BOOLEAN_INPUTS = DPC_POSITIONS,
    BOOLEANS = BOOLEAN_INPUTS + 4
};

typedef struct {
    dpc_controller controller;
    fmi2CallbackFunctions tool;
    double start, time; /* s, of the experiment */
    fmi2Real reals[REALS];
    fmi2Integer integers[INTEGERS];
    fmi2Boolean booleans[BOOLEANS];
    char name[64];
} unit;

static fmi2Status refused(const unit *u, const char *why)
{
    if (u->tool.logger)
        u->tool.logger(u->tool.componentEnvironment, u->name, fmi2Error, "logStatusError", "%s", why);
    return fmi2Error;
}

static fmi2Real *put(fmi2Real *to, const dpc_real *from, int count)
{
    int i;

    for (i = 0; i < count; i++)
        *to++ = from[i];
    return to;
}

/* Makes outputs of a report. */
static void show(unit *u, const dpc_report *report)
{
    const dpc_real numbers[9] = {report->command, report->wish, report->feedforward, report->feedback, report->acting,
                                 report->nis, report->mean_nis, report->error, report->silent};
    const fmi2Integer integers[9] = {report->outcome, report->stopped_by, report->mode, report->used, report->refused,
                                     report->sensor, report->repeats < INT_MAX ? (int)report->repeats : INT_MAX,
                                     report->untrusted, dpc_status(&u->controller)};
    const fmi2Boolean booleans[4] = {report->stop, report->done, report->saturated, report->newly_cut};
    fmi2Real *to = put(u->reals + REAL_INPUTS, numbers, 9);

    to = put(to, report->state, DPC_STATES);
    to = put(to, report->reference, DPC_STATES);
    to = put(to, report->ahead, DPC_STATES);
    to = put(to, report->sigmas, DPC_STATES + DPC_EXTRAS);
#if DPC_EXTRAS > 0
    put(to, report->extra, DPC_EXTRAS);
#endif
    memcpy(u->integers + INTEGER_INPUTS, integers, sizeof integers);
    memcpy(u->booleans + BOOLEAN_INPUTS, booleans, sizeof booleans);
}

/* Begins a run: the newest of the commands on their way is the one that was given last. */
static void begin(unit *u)
{
    dpc_report report;
    int i;

    dpc_init(&u->controller);
    memset(&report, 0, sizeof report);
    report.command = dpc_queued(DPC_LEAD - 1);
    dpc_reference(0, report.state);
    dpc_reference(0, report.reference);
    dpc_reference(DPC_LEAD, report.ahead);
    put(u->reals, report.state, DPC_ARMS);
    u->reals[DPC_ARMS] = report.state[2 * DPC_ARMS];
    u->integers[0] = 0;
    for (i = 0; i < BOOLEAN_INPUTS; i++)
        u->booleans[i] = 1;
    show(u, &report);
}

static void tick(unit *u)
{
    dpc_reading reading;
    dpc_report report;
    int i;

    for (i = 0; i < DPC_POSITIONS; i++) {
        reading.positions[i] = u->reals[i];
        reading.present[i] = u->booleans[i] != 0;
    }
    reading.limit_switch = u->integers[0] != 0;
    reading.age = 0;
    dpc_step(&u->controller, &reading, &report);
    show(u, &report);
}

EXPORT const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

EXPORT const char *fmi2GetVersion(void)
{
    return "2.0";
}

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                     const fmi2CallbackFunctions *tool, fmi2Boolean visible, fmi2Boolean logging)
{
    unit *u;

    if (!tool || !tool->allocateMemory || !tool->freeMemory || type != fmi2CoSimulation || !guid || strcmp(guid, GUID)) {
        if (tool && tool->logger)
            tool->logger(tool->componentEnvironment, name, fmi2Error, "logStatusError",
                         "the model description is of another unit, or the tool asks for what this unit is not");
        return NULL;
    }
    u = tool->allocateMemory(1, sizeof *u);
    if (!u)
        return NULL;
    u->tool = *tool;
    u->start = u->time = 0;
    strncpy(u->name, name ? name : "", sizeof u->name - 1);
    u->name[sizeof u->name - 1] = 0;
    begin(u);
    return u;
}

EXPORT void fmi2FreeInstance(fmi2Component c)
{
    if (c)
        ((unit *)c)->tool.freeMemory(c);
}

EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t count, const fmi2String categories[])
{
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                                      fmi2Boolean has_stop, fmi2Real stop)
{
    unit *u = c;

    if (!isfinite(start))
        return refused(u, "the start of an experiment must be a finite time");
    u->start = u->time = start;
    return fmi2OK;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    return fmi2OK;
}

EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    return fmi2OK;
}

EXPORT fmi2Status fmi2Terminate(fmi2Component c)
{
    return fmi2OK;
}

EXPORT fmi2Status fmi2Reset(fmi2Component c)
{
    unit *u = c;

    u->start = u->time = 0;
    begin(u);
    return fmi2OK;
}

/* Getters and setters of a type; only inputs can be set. */
#define ACCESS(Type, member, inputs, all)                                                                            \
    EXPORT fmi2Status fmi2Get##Type(fmi2Component c, const fmi2ValueReference v[], size_t n, fmi2##Type value[])      \
    {                                                                                                                \
        const unit *u = c;                                                                                           \
        size_t i;                                                                                                    \
                                                                                                                     \
        for (i = 0; i < n; i++) {                                                                                    \
            if (v[i] >= all)                                                                                         \
                return refused(u, "there is no " #Type " variable of this reference");                               \
            value[i] = u->member[v[i]];                                                                              \
        }                                                                                                            \
        return fmi2OK;                                                                                               \
    }                                                                                                                \
    EXPORT fmi2Status fmi2Set##Type(fmi2Component c, const fmi2ValueReference v[], size_t n, const fmi2##Type value[]) \
    {                                                                                                                \
        unit *u = c;                                                                                                 \
        size_t i;                                                                                                    \
                                                                                                                     \
        for (i = 0; i < n; i++) {                                                                                    \
            if (v[i] >= inputs)                                                                                      \
                return refused(u, "there is no " #Type " input of this reference");                                  \
            u->member[v[i]] = value[i];                                                                              \
        }                                                                                                            \
        return fmi2OK;                                                                                               \
    }

ACCESS(Real, reals, REAL_INPUTS, REALS)
ACCESS(Integer, integers, INTEGER_INPUTS, INTEGERS)
ACCESS(Boolean, booleans, BOOLEAN_INPUTS, BOOLEANS)

EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real now, fmi2Real step, fmi2Boolean keeps_state)
{
    unit *u = c;
    const double due = u->start + (double)u->controller.tick * DPC_PERIOD, end = now + step;
    const double periods = step > DPC_PERIOD ? floor(step / DPC_PERIOD + 0.5) : 1;
    const int whole = step <= DPC_PERIOD || fabs(step - periods * DPC_PERIOD) < SAME_TIME;
    const int begins = due < now + SAME_TIME;
    double k;

    if (!(step > 0) || !(fabs(now - u->time) <= SAME_TIME))
        return refused(u, "a step must begin where the last one ended, and last longer than nothing");
    if (begins ? !whole : due < end - SAME_TIME) {
        char why[200];

        snprintf(why, sizeof why,
                 "communication step from %.9g to %.9g s: must be a whole number of the controller's periods of %.9g s "
                 "from the beginning of one, or divide its period",
                 now, end, DPC_PERIOD);
        return refused(u, why);
    }
    for (k = 0; begins && k < periods; k++)
        tick(u);
    u->time = end;
    return fmi2OK;
}

/* What this unit does not have, as its model description says. */

#define NOT_HERE(name, ...)                                   \
    EXPORT fmi2Status name(fmi2Component c, __VA_ARGS__)       \
    {                                                         \
        return refused(c, #name " is not supported");         \
    }

NOT_HERE(fmi2GetString, const fmi2ValueReference v[], size_t n, fmi2String value[])
NOT_HERE(fmi2SetString, const fmi2ValueReference v[], size_t n, const fmi2String value[])
NOT_HERE(fmi2GetFMUstate, fmi2FMUstate *state)
NOT_HERE(fmi2SetFMUstate, fmi2FMUstate state)
NOT_HERE(fmi2FreeFMUstate, fmi2FMUstate *state)
NOT_HERE(fmi2SerializedFMUstateSize, fmi2FMUstate state, size_t *size)
NOT_HERE(fmi2SerializeFMUstate, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
NOT_HERE(fmi2DeSerializeFMUstate, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
NOT_HERE(fmi2GetDirectionalDerivative, const fmi2ValueReference unknown[], size_t unknowns,
         const fmi2ValueReference known[], size_t knowns, const fmi2Real of_known[], fmi2Real of_unknown[])
NOT_HERE(fmi2SetRealInputDerivatives, const fmi2ValueReference v[], size_t n, const fmi2Integer order[],
         const fmi2Real value[])
NOT_HERE(fmi2GetRealOutputDerivatives, const fmi2ValueReference v[], size_t n, const fmi2Integer order[],
         fmi2Real value[])
NOT_HERE(fmi2GetStatus, const fmi2StatusKind kind, fmi2Status *value)
NOT_HERE(fmi2GetRealStatus, const fmi2StatusKind kind, fmi2Real *value)
NOT_HERE(fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
NOT_HERE(fmi2GetBooleanStatus, const fmi2StatusKind kind, fmi2Boolean *value)
NOT_HERE(fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *value)

EXPORT fmi2Status fmi2CancelStep(fmi2Component c)
{
    return refused(c, "fmi2CancelStep is not supported");
}
