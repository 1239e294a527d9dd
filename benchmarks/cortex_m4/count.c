/* Instructions of a step, by the timer of an emulator that runs one instruction per tick of 1 ns. */
#define main tested
#include "robot_test.c"
#undef main

#ifndef PERIOD
#define PERIOD 40 /* [ns] of the system timer */
#endif

int main(void)
{
    volatile uint32_t *const timer = (volatile uint32_t *)0xE000E010; /* control, reload, value */
    enum { STEPS = 1000 };
    robot_memory memory;
    robot_reference reference;
    robot_real u[sizeof robot_result_u[0] / sizeof(robot_real)];
    robot_init(&memory);
    for (unsigned i = 0; i < sizeof reference.q / sizeof *reference.q; ++i) {
        reference.q[i] = robot_given_reference_q[0][i];
    }
    for (unsigned i = 0; i < sizeof reference.v / sizeof *reference.v; ++i) {
        reference.v[i] = robot_given_reference_v[0][i];
        reference.a[i] = robot_given_reference_a[0][i];
    }
    timer[1] = 0xFFFFFF;
    timer[2] = 0;
    timer[0] = 5;
    const uint32_t start = timer[2];
    for (int k = 0; k < STEPS; ++k) {
        (void)robot_step((robot_real)k, robot_given_q[k % 64], robot_given_v[k % 64], &reference, &memory, u);
    }
    const uint32_t ticks = (start - timer[2]) & 0xFFFFFF;
    printf("%lu\n", (unsigned long)(ticks * (unsigned long)PERIOD / STEPS));
    return tested();
}
