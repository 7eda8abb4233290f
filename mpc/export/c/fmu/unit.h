/* Interface of an FMU of this project: values, a memory, and a step of fixed length. fmu.c is the same for all. */
#ifndef ANT_UNIT_H
#define ANT_UNIT_H

#include "fmi3Functions.h"
#include "unit_variables.h" /* written for this FMU, as modelDescription.xml */

/* Position of the values of a variable, and when it may be set. */
typedef struct {
    int whole; /* an Int32; else Float64 */
    int first; /* of its values */
    int count; /* more than one of an array */
    int set;    /* 0: never, 1: before the simulation begins, 2: always */
    int finite; /* whether NaN and infinity are refused; otherwise the unit handles them */
} unit_variable;

/* Its own part: plant_unit.c or controller_unit.c. */
typedef struct unit_memory unit_memory;
size_t unit_memory_size(void);
void unit_begin(unit_memory *memory, double *v);   /* once the start values are there */
int unit_advance(unit_memory *memory, double *v);  /* by UNIT_DT, from inputs to outputs; whether these are numbers */

/* Report an error to the simulator; returns fmi3Error. */
fmi3Status unit_complain(fmi3Instance instance, const char *format, ...);

#endif /* ANT_UNIT_H */
