/* Instructions of an allocation on a Cortex-M4F, of which QEMU counts one a nanosecond (-icount shift=0), by the SysTick
 * timer of 25 MHz: the demonstration's targets anew, and a little beside them with `follow`. */
#include <stdint.h>
#include <stdio.h>

#include "antagonist.h"
#include "demonstration.h"

static volatile uint32_t *const SYSTICK = (volatile uint32_t *)0xE000E010u; /* control, reload, value */
static ant_memory memory;

static double counted(const ant_target *target) {
    ant_allocation a;
    SYSTICK[1] = 0xFFFFFF;
    SYSTICK[2] = 0;
    SYSTICK[0] = 5;
    const uint32_t began = SYSTICK[2];
    ant_allocate(target, &memory, &a);
    return ((began - SYSTICK[2]) & 0xFFFFFF) * 40.0;
}

int main(void) {
    for (int i = 0; i < ANT_DEMONSTRATIONS; i++) {
        const ant_real *row = ANT_DEMONSTRATION[i];
        ant_target target = ant_target_of(row, row + ANT_JOINTS);
        for (int k = 0; k < ANT_STIFFNESSES; k++) target.K[k] = row[2 * ANT_JOINTS + k];
        const double anew = counted(&target);
        target.T[0] += (ant_real)0.02;
        target.follow = 1;
        const double followed = counted(&target);
        printf("%.0f %.0f\n", anew, followed);
    }
    printf("%d 0\n", (int)sizeof memory);
    return 0;
}
