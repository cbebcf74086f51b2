/* Start of a Cortex-M4 with floating point under qemu: vectors, FPU, memory, then main with the arguments it is given. */
#include <stdlib.h>

extern unsigned long data_begin, data_end, data_source, bss_begin, bss_end, stack_top;
extern void initialise_monitor_handles(void);
int main(int count, char **arguments);

void start(void);
void _init(void);
void _fini(void);

void _init(void) {}
void _fini(void) {}

void start(void)
{
    static char program[] = "replay", readings[] = "readings.csv";
    static char *arguments[] = { program, readings, NULL };
    unsigned long *from = &data_source, *to = &data_begin;

    *(volatile unsigned long *)0xE000ED88 |= 0xF00000; /* the coprocessor that computes in floating point */
    while (to < &data_end)
        *to++ = *from++;
    for (to = &bss_begin; to < &bss_end; to++)
        *to = 0;
    initialise_monitor_handles();
    exit(main(2, arguments));
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
