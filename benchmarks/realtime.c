/* Robot process: the exported plant, one step per period, states and inputs over UDP.
 *
 * robot PORT_IN PORT_OUT PERIOD_NS SECONDS FIFO SILENT_FROM_NS
 *
 * At its end, the robot prints the number of its own missed deadlines, and of its periods. */
#define _GNU_SOURCE
#include "robot.h"
#include <arpa/inet.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <time.h>

#define SILENCE 200000000L /* [ns] */

static struct sockaddr_in at(int port)
{
    struct sockaddr_in address;
    memset(&address, 0, sizeof address);
    address.sin_family = AF_INET;
    address.sin_port = htons((unsigned short)port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    return address;
}

int main(int count, char **words)
{
    if (count != 7) return 2;
    const struct sockaddr_in in = at(atoi(words[1])), out = at(atoi(words[2]));
    const long period = atol(words[3]), samples = (long)(atof(words[4]) * 1e9 / (double)period);
    const long silent = atol(words[6]);
    if (atoi(words[5])) {
        const struct sched_param priority = {.sched_priority = 60};
        if (sched_setscheduler(0, SCHED_FIFO, &priority)) perror("SCHED_FIFO");
        if (mlockall(MCL_CURRENT | MCL_FUTURE)) perror("mlockall");
    }
    const int line = socket(AF_INET, SOCK_DGRAM, 0);
    if (line < 0 || bind(line, (const struct sockaddr *)&in, sizeof in)) return 3;
    robot_memory memory;
    robot_init(&memory);
    double u[NU] = {0}, state[1 + NQ + NV];
    long late = 0;
    int is_driven = 0; /* the robot rests until its first input */
    struct timespec due;
    clock_gettime(CLOCK_MONOTONIC, &due);
    for (long k = 0; k < samples; ++k) {
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL)) continue;
        char data[sizeof u];
        for (ssize_t size; (size = recv(line, data, sizeof data, MSG_DONTWAIT)) >= 0;) {
            if (size != (ssize_t)sizeof data) { /* the controller stops the robot */
                printf("%ld %ld\n", late, k);
                return 0;
            }
            memcpy(u, data, sizeof u);
            is_driven = 1;
        }
        if (is_driven && robot_step((double)k * 1e-9 * (double)period, u, &memory)) return 4;
        struct timespec now;
        clock_gettime(CLOCK_MONOTONIC, &now);
        late += (now.tv_sec - due.tv_sec) * 1000000000L + now.tv_nsec - due.tv_nsec >= period;
        state[0] = (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
        memcpy(state + 1, memory.q, sizeof memory.q);
        memcpy(state + 1 + NQ, memory.v, sizeof memory.v);
        const long time = k * period;
        if (silent <= 0 || time < silent || time >= silent + SILENCE)
            sendto(line, state, sizeof state, 0, (const struct sockaddr *)&out, sizeof out);
        due.tv_nsec += period;
        if (due.tv_nsec >= 1000000000L) {
            due.tv_nsec -= 1000000000L;
            ++due.tv_sec;
        }
    }
    return 0;
}
