/* DAQP's core, its files unmodified, as one unit in the precision chosen at export. */
#include "daqp_core.h"

#include "daqp/auxiliary.c"
#include "daqp/daqp.c"
#include "daqp/factorization.c"
