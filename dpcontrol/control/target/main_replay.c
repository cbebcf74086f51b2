/* Feeds readings from a file to the controller and prints what it commands.
 *
 *     ./replay READINGS.csv [TOLERANCE]
 *     ./replay READINGS.bin
 *
 * CSV: a line of names, then a line for each tick. Columns, in any order, others are ignored: @COLUMNS@
 * (rad, then m; empty or nan: not measured), limit_switch (0 or 1; may be missing), control.command (m/s^2; may
 * be missing: the command before limits that is expected). `log.frame().to_csv(FILE)` in dpcontrol writes such a file.
 * Binary: for each tick DPC_POSITIONS + 2 doubles of this machine: positions, limit switch, command; nan: not known.
 *
 * Prints tick,command,wish,outcome,status. A command that is given is what the drive got, and is told to the controller,
 * whose own would drift away from it: estimator and law alone, without the arms, are not stable. Exits with 1 if one is
 * farther than TOLERANCE (@TOLERANCE@ m/s^2) from the controller's wish.
 */
#include "dpc_controller.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LONGEST 8192
#define MOST_COLUMNS 256
enum { SWITCH = DPC_POSITIONS, WISH, KINDS };

static const char *const names[KINDS] = { @NAMES@, "limit_switch", "control.command" };
static int kinds[MOST_COLUMNS], columns;

/* Cut the next field off a line of CSV. */
static char *field(char **rest)
{
    char *begin = *rest, *end = begin ? begin + strcspn(begin, ",\r\n") : NULL;

    if (!begin)
        return NULL;
    *rest = *end == ',' ? end + 1 : NULL;
    *end = '\0';
    return begin;
}

static int read_names(FILE *file)
{
    char line[LONGEST], *rest = line, *name;
    int found[KINDS] = { 0 }, k;

    if (!fgets(line, sizeof line, file))
        return 0;
    while (columns < MOST_COLUMNS && (name = field(&rest)) != NULL) {
        kinds[columns] = -1;
        for (k = 0; k < KINDS; k++)
            if (!strcmp(name, names[k]))
                kinds[columns] = k, found[k] = 1;
        columns++;
    }
    for (k = 0; k < DPC_POSITIONS; k++)
        if (!found[k])
            return 0;
    return 1;
}

static int next_line(FILE *file, double values[KINDS])
{
    char line[LONGEST], *rest = line, *text;
    int k;

    if (!fgets(line, sizeof line, file))
        return 0;
    for (k = 0; k < columns && (text = field(&rest)) != NULL; k++)
        if (kinds[k] >= 0 && *text)
            values[kinds[k]] = strtod(text, NULL);
    return 1;
}

int main(int count, char **arguments)
{
    static dpc_controller controller;
    const char *name = count > 1 ? arguments[1] : "";
    const size_t length = strlen(name);
    const int binary = length > 4 && !strcmp(name + length - 4, ".bin");
    const double tolerance = count > 2 ? strtod(arguments[2], NULL) : @TOLERANCE@;
    double worst = 0, values[KINDS];
    long tick, compared = 0;
    FILE *file;
    int k;

    if (count < 2 || count > 3) {
        fprintf(stderr, "usage: %s READINGS.csv [TOLERANCE] | READINGS.bin\n", arguments[0]);
        return 2;
    }
    file = fopen(name, binary ? "rb" : "r");
    if (!file) {
        fprintf(stderr, "cannot open %s\n", name);
        return 2;
    }
    if (!binary && !read_names(file)) {
        fprintf(stderr, "%s: the first line must name the columns @COLUMNS@\n", name);
        fclose(file);
        return 2;
    }
    dpc_init(&controller);
    printf("tick,command,wish,outcome,status\n");
    for (tick = 0;; tick++) {
        dpc_reading reading;
        dpc_report report;

        for (k = 0; k < KINDS; k++)
            values[k] = k == SWITCH ? 0 : NAN;
        if (binary ? fread(values, sizeof *values, KINDS, file) != KINDS : !next_line(file, values))
            break;
        for (k = 0; k < DPC_POSITIONS; k++) {
            reading.positions[k] = values[k];
            reading.present[k] = !isnan(values[k]);
        }
        reading.limit_switch = values[SWITCH] != 0;
        reading.age = 0;
        dpc_step(&controller, &reading, &report);
        printf("%ld,%.17g,%.17g,%d,%d\n", tick, (double)report.command, (double)report.wish, report.outcome,
               dpc_status(&controller));
        if (!isnan(values[WISH])) {
            const double away = fabs((double)report.wish - values[WISH]);

            compared++;
            if (!(away <= worst))
                worst = away;
            dpc_sent(&controller, (dpc_real)fmax(fmin(values[WISH], DPC_ACCELERATION), -DPC_ACCELERATION));
        }
    }
    fclose(file);
    if (!compared)
        return 0;
    fprintf(stderr, "%ld ticks, commands differ by %.3g m/s^2 at most; %g allowed\n", compared, worst, tolerance);
    return worst <= tolerance ? 0 : 1;
}
