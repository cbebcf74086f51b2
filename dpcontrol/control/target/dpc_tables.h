/* The tables of @ITINERARY_COMMENT@: for dpc_controller.c alone. */
#ifndef DPC_TABLES_H
#define DPC_TABLES_H

#include "dpc_controller.h"

#define DPC_STATE_ROWS @STATE_ROWS@L
#define DPC_LAW_ROWS @LAW_ROWS@L
#define DPC_LAW_COLUMNS @LAW_COLUMNS@

/* The reference at each tick: rad, rad/s, m, m/s. */
extern const dpc_real dpc_states[DPC_STATE_ROWS][DPC_STATES];
/* Of each tick's command: @LAW_NAMES@. */
extern const dpc_real dpc_law[DPC_LAW_ROWS][DPC_LAW_COLUMNS];
/* The memory before the first tick. */
extern const dpc_real dpc_start[DPC_MEMORY];
/* Commands on their way then, m/s^2. */
extern const dpc_real dpc_first_commands[@QUEUED@];

#endif
