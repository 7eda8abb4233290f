/* Reads files of `antagonist export tuning`, on machines that have files. */
#ifndef ANT_TUNING_FILE_H
#define ANT_TUNING_FILE_H

#include <stdio.h>
#include <stdlib.h>

#include "antagonist.h"

/* The tuning in a file, numbers one a line and remarks behind #: whether it is one of this build. */
static inline int ant_read_tuning(const char *name, ant_tuning *tuning) {
    ant_real numbers[ANT_TUNING_NUMBERS + 1];
    char line[256];
    int count = 0;
    FILE *file = fopen(name, "r");
    while (file != NULL && count <= ANT_TUNING_NUMBERS && fgets(line, sizeof line, file) != NULL) {
        char *end;
        const double number = strtod(line, &end);
        if (end != line) numbers[count++] = (ant_real)number;
    }
    if (file != NULL) fclose(file);
    return ant_tuning_from(numbers, count, tuning);
}

#endif /* ANT_TUNING_FILE_H */
