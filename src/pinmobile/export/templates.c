/* Texts of exported files. Each section begins with its name; $words are replaced. */

/* = header */
/* $title: one sample in C99.
   Made by pinmobile $version; hash of the content: $digest. */
#ifndef ${UPPER}_H
#define ${UPPER}_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ${UPPER}_HASH "$digest"
#define ${UPPER}_DT $dt_c /* time step [s]: call the step every $dt s */
#define ${UPPER}_NQ $nq /* entries of q */
#define ${UPPER}_NV $nv /* entries of v */
#define ${UPPER}_NU $nu /* entries of u */

$types

/* Result of a step. If it is not OK, memory and output are as before the call. */
typedef enum {
    ${UPPER}_OK = 0,
    ${UPPER}_NOT_FINITE = 1, /* an argument or a result is NaN or infinite */
    ${UPPER}_STALE = 2 /* t is not later than the time of the sample before */
} ${name}_status;

/* Begin: the memory before the first sample. */
void ${name}_init(${name}_memory *memory);

/* $purpose Arguments:
$arguments */
$prototype;
$declarations
#ifdef __cplusplus
}
#endif

#endif /* ${UPPER}_H */

/* = declare_parameters */
/* Default, smallest and largest values of the parameters; infinite without a bound. */
extern const ${name}_parameters ${name}_default;
extern const ${name}_parameters ${name}_lower;
extern const ${name}_parameters ${name}_upper;

/* Return 1 if all parameters are within their bounds, else 0. */
int ${name}_are_valid(const ${name}_parameters *parameters);

/* = declare_table */
/* Compute the reference at a time, by interpolation between samples of the trajectory,
   $orders: position, velocity and acceleration are continuous.
   At t = k * ${UPPER}_DT, it is exactly the sample. After the end, the reference rests. */
void ${name}_reference_at(${name}_real t, ${name}_reference *reference);

/* = source */
/* $title: one sample in C99, see $name.h.
   Made by pinmobile $version; hash of the content: $digest. */
#include "$name.h"

#include <float.h>
#include <math.h>

#if !defined(FLT_EVAL_METHOD) || FLT_EVAL_METHOD != 0
#error each operation must round to its own type: on x86, compile for SSE2
#endif
#ifdef __FAST_MATH__
#error compile without -ffast-math, which changes the order of operations
#endif
#if !defined(__GNUC__) || defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#else
/* GCC has no such pragma: compile with -ffp-contract=off, which its vectors do not obey on processors with FMA. */
#pragma GCC optimize ("no-tree-vectorize")
#endif

$body

/* = body */
$helpers

void ${name}_init(${name}_memory *memory)
{
    memory->t = 0;
    memory->k = 0;
$starts
}

$prototype
{
$beginning
    if ($not_finite) {
        return ${UPPER}_NOT_FINITE;
    }
    if (memory->k > 0 && !(t > memory->t)) {
        return ${UPPER}_STALE;
    }
$statements
    const ${name}_real results[] = {
        $results
    };
    if (!${name}_is_finite(results, $count)) {
        return ${UPPER}_NOT_FINITE;
    }
$assignments
    memory->t = t;
    memory->k += memory->k < UINT32_MAX;
    return ${UPPER}_OK;
}

/* = is_finite */
static int ${name}_is_finite(const ${name}_real *x, int n)
{
    for (int i = 0; i < n; ++i) {
        if (!(x[i] - x[i] == 0)) {
            return 0;
        }
    }
    return 1;
}

/* = bits */
static uint64_t ${name}_bits(double x)
{
    union { double real; uint64_t bits; } word;
    word.real = x;
    return word.bits;
}

/* = from_bits */
static double ${name}_from_bits(uint64_t x)
{
    union { double real; uint64_t bits; } word;
    word.bits = x;
    return word.real;
}

/* = delay */
    for (uint32_t i = 0; memory->k == 0 && i < ${samples}u; ++i) {
        $place[i] = $value;
    }
    $place[memory->at_$samples] = $value;

/* = parameters */
const ${name}_parameters ${name}_default = {$default};
const ${name}_parameters ${name}_lower = {$lower};
const ${name}_parameters ${name}_upper = {$upper};

int ${name}_are_valid(const ${name}_parameters *parameters)
{
$tests
    return 1;
}

/* = parameter */
    for (int i = 0; i < $count; ++i) {
        const ${name}_real x = parameters->$member[i];
        if (!${name}_is_finite(&x, 1) || x $below ${name}_lower.$member[i] || x > ${name}_upper.$member[i]) {
            return 0;
        }
    }

/* = interpolation */
void ${name}_reference_at(${name}_real t, ${name}_reference *reference)
{
    const ${name}_real h = ${UPPER}_DT, place = t / h, half = $half, near = $near;
    const int rests = place - (${name}_real)$last >= near;
    const uint32_t nearest = rests ? ${last}u : (uint32_t)(place > 0 ? place + half : 0);
    const ${name}_real off = place - (${name}_real)nearest;
    if (rests || !(place > 0) || (off < near && off > -near)) {
        for (int i = 0; i < $n; ++i) {
            reference->q[i] = ${name}_table[nearest][i];
            reference->v[i] = rests ? 0 : ${name}_table[nearest][$n + i];
            reference->a[i] = rests ? 0 : ${name}_table[nearest][2 * $n + i];
        }
        return;
    }
    const uint32_t k = off < 0 ? nearest - 1u : nearest;
    const ${name}_real s = place - (${name}_real)k;
    for (int i = 0; i < $n; ++i) {
        const ${name}_real *const from = ${name}_table[k], *const to = ${name}_table[k + 1u];
        const ${name}_real d = to[i] - from[i], v0 = h * from[$n + i], v1 = h * to[$n + i];
        const ${name}_real a0 = h * h * from[2 * $n + i], a1 = h * h * to[2 * $n + i];
        const ${name}_real c3 = 10 * d - 6 * v0 - 4 * v1 - half * (3 * a0 - a1);
        const ${name}_real c4 = -15 * d + 8 * v0 + 7 * v1 + half * (3 * a0 - 2 * a1);
        const ${name}_real c5 = 6 * d - 3 * (v0 + v1) - half * (a0 - a1);
        reference->q[i] = from[i] + s * (v0 + s * (half * a0 + s * (c3 + s * (c4 + s * c5))));
$derivatives
    }
}

/* = derivatives */
        reference->v[i] = (v0 + s * (a0 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))) / h;
        reference->a[i] = (a0 + s * (6 * c3 + s * (12 * c4 + s * 20 * c5))) / (h * h);

/* = derivatives_single */
        /* Differences of positions, which round, are not divided by h. */
        const ${name}_real first = from[2 * $n + i], last = to[2 * $n + i], w = to[$n + i] - from[$n + i];
        const ${name}_real c2 = 3 * w - h * (2 * first + last), c = h * (first + last) - 2 * w;
        reference->v[i] = from[$n + i] + s * (h * first + s * (c2 + s * c));
        reference->a[i] = first + s * (last - first);

/* = test */
/* Test of $name.c with recorded arguments and results: it prints the largest difference. */
#include "$name.h"

#include <math.h>
#include <stdio.h>

$arrays

static double larger(double a, double b)
{
    const double size = fabs(b);
    return size <= a ? a : size; /* NaN counts as a difference */
}

int main(void)
{
    ${name}_memory memory;
    double off = 0;
$own
    ${name}_init(&memory);
    for (int k = 0; k < $samples; ++k) {
$fills
        if ($call != ${UPPER}_OK) {
            printf("sample %d failed\n", k);
            return 1;
        }
$compared
    }
    printf("largest difference of $samples samples: %g, allowed: $limit\n", off);
    return off <= $limit ? 0 : 1;
}

/* = cmake */
cmake_minimum_required(VERSION 3.10)
project($name C)

set(CMAKE_C_STANDARD 99)
set(CMAKE_C_STANDARD_REQUIRED ON)

add_library($name STATIC $name.c)
target_include_directories($name PUBLIC $${CMAKE_CURRENT_SOURCE_DIR})
target_compile_options($name PRIVATE -ffp-contract=off)
target_link_libraries($name PUBLIC m)

enable_testing()
add_executable(${name}_test ${name}_test.c)
target_link_libraries(${name}_test PRIVATE $name)
add_test(NAME $name COMMAND ${name}_test)

/* = readme */
# $name: $title

Made by pinmobile $version. On the robot, two files are enough: `$name.h` and `$name.c`, in C99. They use no heap, no global
state, and of the C library only `sqrt` and `fabs`. The header states names, units, frames and limits of all entries.

|  |  |
|---|---|
| precision | $precision |
| time step | $dt s |
| operations of a step | $operations |
| memory | $memory bytes for each robot |
| constant tables | $constants bytes |
| largest stack | below $stack bytes, without optimisation |
| hash | `$digest`, also `${UPPER}_HASH` |

```c
#include "$name.h"

$declared
${name}_init(&memory);
for (;;) { /* every $dt s */
$refer    if ($call != ${UPPER}_OK) {
        /* stop the robot */
    }
}
```

- NaN or infinity in an argument or a result: the step returns `${UPPER}_NOT_FINITE`. Memory and output do not change.
- A stale measurement, whose time `t` is not later than the time before: the step returns `${UPPER}_STALE`. Memory and output
  do not change.
- The law assumes steps of $dt s: call it with t = k * $dt, not with a sum of steps. To begin again, call `${name}_init`, which also
  sets the parameters to their defaults. After a longer gap, a step computes as usual: stop the robot by a watchdog.
$notes- Compile without `-ffast-math` and with `-ffp-contract=off`, so that results do not depend on the compiler.

Test with recorded arguments and results:

    cc -std=c99 -O2 -ffp-contract=off $name.c ${name}_test.c -lm -o ${name}_test && ./${name}_test

or `cmake -B build && cmake --build build && ctest --test-dir build`.

/* = note_parameters */
- Parameters are in `memory.parameters`. Change them between two steps, and check them by `${name}_are_valid`: the
  step does not.

/* = note_table */
- `${name}_reference_at` interpolates the samples of the trajectory by polynomials, $orders. At
  t = k * ${UPPER}_DT, it returns the samples exactly. After the end, the reference rests.

/* = note_plant */
- `memory.q` and `memory.v` are the state. On rolling wheels, the next step projects `v` onto the rolling constraints: before
  it, `v` differs by rounding from the library's.
