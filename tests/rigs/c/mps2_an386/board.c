/* The least that a Cortex-M4F or M7 needs before newlib's _start: a vector table, and the FPU switched on. */
#include <stdint.h>

extern void _start(void);
extern char __stack[];

static void reset(void) {
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20; /* CPACR: full access to the FPU */
    __asm volatile("dsb\n isb");
    _start();
}

__attribute__((section(".vectors"), used)) static const struct {
    void *stack;
    void (*reset)(void);
} vectors = {__stack, reset};
