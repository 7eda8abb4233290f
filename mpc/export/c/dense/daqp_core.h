/* DAQP's interface in the precision chosen at export. */
#ifndef ANT_DAQP_CORE_H
#define ANT_DAQP_CORE_H

#include "antagonist_config.h"

#ifdef ANT_SINGLE
#define DAQP_SINGLE_PRECISION
#endif
#define DAQP_NO_SOFT_WEIGHTS

#include "daqp/daqp.h"

#endif /* ANT_DAQP_CORE_H */
