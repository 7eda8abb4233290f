/* Two equal Tondu2021 muscles on a pulley, at an angle. */
#ifndef ANT_LAW_STATE_H
#define ANT_LAW_STATE_H

#include "antagonist.h"

typedef struct {
    ant_real eps[2]; /* contraction ratios [-] */
} ant_law;

#endif /* ANT_LAW_STATE_H */
