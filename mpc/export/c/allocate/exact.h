/* The kernel (kernel.c), for valid targets. */
#ifndef ANT_EXACT_H
#define ANT_EXACT_H

#include "kernel.h"

ant_answer ant_exact(const ant_target *target);

#endif /* ANT_EXACT_H */
