/* The tables of outer-turn: for dpc_controller.c alone. */
#ifndef DPC_TABLES_H
#define DPC_TABLES_H

#include "dpc_controller.h"

#define DPC_STATE_ROWS 4877L
#define DPC_LAW_ROWS 4875L
#define DPC_LAW_COLUMNS 24

/* The reference at each tick: rad, rad/s, m, m/s. */
extern const dpc_real dpc_states[DPC_STATE_ROWS][DPC_STATES];
/* Of each tick's command: feedforward, gain 1, gain 2, gain 3, gain 4, gain 5, gain 6, gain on drive, gain on friction_1, gain on friction_2, gain on M11, gain on M22, gain on S1, gain on S2, gain on M11 M11, gain on M11 M22, gain on M11 S1, gain on M11 S2, gain on M22 M22, gain on M22 S1, gain on M22 S2, gain on S1 S1, gain on S1 S2, gain on S2 S2. */
extern const dpc_real dpc_law[DPC_LAW_ROWS][DPC_LAW_COLUMNS];
/* The memory before the first tick. */
extern const dpc_real dpc_start[DPC_MEMORY];
/* Commands on their way then, m/s^2. */
extern const dpc_real dpc_first_commands[1];

#endif
