/* The tables of @ITINERARY_COMMENT@: for dpc_controller.c alone. */
#ifndef DPC_TABLES_H
#define DPC_TABLES_H

#include "dpc_controller.h"

#define DPC_PIECES @PIECES@
#define DPC_LARGE @LARGE@
#define DPC_SMALL @SMALL@
#define DPC_VALUES @VALUES@

/* The first tick of each piece of the reference, and its number of ticks. */
extern const long dpc_pieces[DPC_PIECES + 1];
/* Over each piece, the coefficients of Chebyshev polynomials for the values of a tick: @NAMES_OF_VALUES@.
 * States are those of the reference: rad, rad/s, m, m/s. The small coefficients of high degree are floats. */
extern const dpc_real dpc_large[DPC_PIECES][DPC_LARGE][DPC_VALUES];
extern const float dpc_small[DPC_PIECES][DPC_SMALL][DPC_VALUES];
/* The memory before the first tick. */
extern const dpc_real dpc_start[DPC_MEMORY];
/* Commands on their way then, m/s^2. */
extern const dpc_real dpc_first_commands[@QUEUED@];

#endif
