/* Start of a Cortex-M with floating point under qemu: vectors, FPU, memory, then main with the arguments it is given.
 *
 * Linked with --wrap=dpc_step, it prints how many instructions the steps took. With -icount shift=0, an instruction takes
 * 1 ns, and the timer of these boards counts every 40 ns.
 */
#include "dpc_controller.h"

#include <stdio.h>
#include <stdlib.h>

#define TIMER ((volatile unsigned long *)0xE000E010) /* control, first value, value; it counts down from 24 bits */
#define INSTRUCTIONS 40

extern unsigned long data_begin, data_end, data_source, bss_begin, bss_end, stack_top;
extern void initialise_monitor_handles(void);
int main(int count, char **arguments);

dpc_real __real_dpc_step(dpc_controller *controller, const dpc_reading *reading, dpc_report *report);
dpc_real __wrap_dpc_step(dpc_controller *controller, const dpc_reading *reading, dpc_report *report);
void start(void);
void _init(void);
void _fini(void);

static unsigned long steps, most;
static unsigned long long all;

void _init(void) {}
void _fini(void) {}

dpc_real __wrap_dpc_step(dpc_controller *controller, const dpc_reading *reading, dpc_report *report)
{
    const unsigned long before = TIMER[2];
    const dpc_real command = __real_dpc_step(controller, reading, report);
    const unsigned long took = (before - TIMER[2]) & 0xFFFFFF;

    steps++;
    all += took;
    if (took > most)
        most = took;
    return command;
}

void start(void)
{
    static char program[] = "replay", readings[] = "readings.csv";
    static char *arguments[] = { program, readings, NULL };
    unsigned long *from = &data_source, *to = &data_begin;
    int failed;

    *(volatile unsigned long *)0xE000ED88 |= 0xF00000; /* the coprocessor that computes in floating point */
    while (to < &data_end)
        *to++ = *from++;
    for (to = &bss_begin; to < &bss_end; to++)
        *to = 0;
    TIMER[1] = 0xFFFFFF;
    TIMER[0] = 5;
    initialise_monitor_handles();
    failed = main(2, arguments);
    fprintf(stderr, "instructions: %lu in the mean, %lu at most\n", (unsigned long)(INSTRUCTIONS * all / steps),
            INSTRUCTIONS * most);
    exit(failed);
}

static void failed(void)
{
    for (;;)
        ;
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top, (const void *)start, (const void *)failed, (const void *)failed, (const void *)failed,
    (const void *)failed, (const void *)failed
};
