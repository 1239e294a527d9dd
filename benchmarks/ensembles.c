/* The limit: the ensemble by hand in C, blocks of robots with the time loop inside, each loop over a block
 * made for vectors. Compiled by ensemble_contestants/of_c.py; -DLIBM takes sine and cosine from libm. */

#include <math.h>
#include <omp.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define BLOCK 64          /* robots that go through time together: their state stays in the first cache */
#define LANES 8           /* a block is filled up to a whole number of vectors */
#define OCTAVES 84        /* of the histograms: from 2^-54 to 2^30 */
#define BINS (32 * OCTAVES + 2) /* with the one below and the one above */
#define LEAST 0x1.fcp-55        /* in the bin below */
#define MOST 0x1p+30            /* in the bin above */
#define PI 3.14159265358979312
#define PI_REST 1.22464679914735321e-16 /* pi - PI */
#define ROUND 0x1.8p52    /* added, it rounds to a whole number, whose parity is the last bit */

typedef double Lane[BLOCK] __attribute__((aligned(64)));

typedef struct { /* all robots alike: plant's inertia, step, gain, and the robot that the controller knows */
    double inertia, dt, gain, known_mass, known_com, known_inertia;
} Shared;

typedef struct {
    Lane x, y, psi, u, w, r;                      /* q and v */
    Lane com, inverse_mass;                       /* of the plant */
    Lane sine, cosine, fx, fy, mz;                /* of this sample, as are the next two */
    Lane distance, turn;                          /* squared distance and |e_psi|, where they are counted */
    Lane ex, ey, ep, sx, sy, sp, tx, ty, tz, far; /* largest |e|, sums of e^2, largest |tau|, distance^2 */
} Block;

static inline int64_t bits(double value) {
    int64_t whole;
    memcpy(&whole, &value, sizeof whole);
    return whole;
}

static inline double flipped(double value, int64_t sign) {
    int64_t whole = bits(value) ^ sign;
    memcpy(&value, &whole, sizeof value);
    return value;
}

static inline double larger(double a, double b) { return a > b ? a : b; }

/* Chebyshev interpolation in r^2 on |r| <= pi/2, to 2e-16; in pairs, for the processor to overlap. */
static inline void sine_cosine(double psi, double *s, double *c) {
    double t = psi * (1 / PI) + ROUND, k = t - ROUND;
    double r = (psi - k * PI) - k * PI_REST, z = r * r, z2 = z * z, z4 = z2 * z2;
    int64_t sign = bits(t) << 63;
    double p = (-1.6666666666666072e-01 + z * 8.333333333282756e-03) +
               z2 * (-1.9841269824861897e-04 + z * 2.7557316609073673e-06) +
               z4 * ((-2.505188194671259e-08 + z * 1.6048168318165643e-10) - z2 * 7.374387503862757e-13);
    double g = (-4.999999999999997e-01 + z * 4.166666666666388e-02) +
               z2 * (-1.388888888877299e-03 + z * 2.4801587277414926e-05) +
               z4 * ((-2.755731639102575e-07 + z * 2.0876561839933163e-09) +
                     z2 * (-1.1462901901757276e-11 + z * 4.608977003001797e-14));
    *s = flipped(r + r * z * p, sign);
    *c = flipped(1 + z * g, sign);
}

/* Each loop is short, so that its next turns begin while the chain of operations in this one waits. */
static inline void turn(Block *b, long count) {
#ifdef LIBM
    for (long i = 0; i < count; i++) b->sine[i] = sin(b->psi[i]), b->cosine[i] = cos(b->psi[i]);
#else
#pragma omp simd
    for (long i = 0; i < count; i++) sine_cosine(b->psi[i], &b->sine[i], &b->cosine[i]);
#endif
}

static inline void control(Block *b, long count, const double *at, const Shared *all, int counted) {
    const double gain = all->gain, m = all->known_mass, l = all->known_com;
    const double inertia = all->known_inertia + m * l * l;
#pragma omp simd
    for (long i = 0; i < count; i++) {
        double r = b->r[i], dx = l * b->cosine[i], dy = l * b->sine[i];
        double ex = at[0] - b->x[i], ey = at[1] - b->y[i], ep = at[2] - b->psi[i];
        ep -= 2 * PI * ((ep * (0.5 / PI) + ROUND) - ROUND);
        double ax = at[6] + gain * ((at[3] - b->u[i]) + ex);
        double ay = at[7] + gain * ((at[4] - b->w[i]) + ey);
        double ar = at[8] + gain * ((at[5] - r) + ep);
        double fx = m * (ax - dy * ar - r * r * dx);
        double fy = m * (ay + dx * ar - r * r * dy);
        double mz = m * (dx * ay - dy * ax) + inertia * ar;
        double xx = ex * ex, yy = ey * ey, far = xx + yy;
        b->fx[i] = fx, b->fy[i] = fy, b->mz[i] = mz;
        b->sx[i] += xx, b->sy[i] += yy, b->sp[i] += ep * ep;
        b->far[i] = larger(far, b->far[i]);
        b->ex[i] = larger(fabs(ex), b->ex[i]);
        b->ey[i] = larger(fabs(ey), b->ey[i]);
        b->ep[i] = larger(fabs(ep), b->ep[i]);
        b->tx[i] = larger(fabs(fx), b->tx[i]);
        b->ty[i] = larger(fabs(fy), b->ty[i]);
        b->tz[i] = larger(fabs(mz), b->tz[i]);
        if (counted) b->distance[i] = far, b->turn[i] = fabs(ep);
    }
}

static inline void move(Block *b, long count, const Shared *all) {
    const double dt = all->dt, half = dt * dt / 2, inverse_inertia = 1 / all->inertia;
#pragma omp simd
    for (long i = 0; i < count; i++) {
        double dx = b->com[i] * b->cosine[i], dy = b->com[i] * b->sine[i], r = b->r[i];
        double ar = (b->mz[i] + dy * b->fx[i] - dx * b->fy[i]) * inverse_inertia;
        double ax = b->fx[i] * b->inverse_mass[i] + r * r * dx + dy * ar;
        double ay = b->fy[i] * b->inverse_mass[i] + r * r * dy - dx * ar;
        b->x[i] += dt * b->u[i] + half * ax, b->u[i] += dt * ax;
        b->y[i] += dt * b->w[i] + half * ay, b->w[i] += dt * ay;
        b->psi[i] += dt * r + half * ar, b->r[i] = r + dt * ar;
    }
}

static inline int64_t bin(double value) {
    value = larger(value, LEAST);
    return (bits(value < MOST ? value : MOST) >> 47) - (bits(LEAST) >> 47);
}

static void count_errors(const Block *b, long real, int32_t *distances, int32_t *turns) {
    for (long i = 0; i < real; i++) {
        distances[bin(sqrt(b->distance[i]))]++;
        turns[bin(b->turn[i])]++;
    }
}

static void begin(Block *b, long real, long count, const double *start, const double *mass,
                  const double *com) {
    memset(b, 0, sizeof *b);
    for (long i = 0; i < count; i++) {
        b->x[i] = start[0], b->y[i] = start[1], b->psi[i] = start[2];
        b->u[i] = start[3], b->w[i] = start[4], b->r[i] = start[5];
        b->com[i] = i < real ? com[i] : 0.0;
        b->inverse_mass[i] = i < real ? 1 / mass[i] : 1.0;
    }
}

static void end(const Block *b, long real, long samples, double *to) {
    for (long i = 0; i < real; i++, to += 10) {
        to[0] = b->ex[i], to[1] = b->ey[i], to[2] = b->ep[i];
        to[3] = sqrt(b->sx[i] / samples), to[4] = sqrt(b->sy[i] / samples), to[5] = sqrt(b->sp[i] / samples);
        to[6] = b->tx[i], to[7] = b->ty[i], to[8] = b->tz[i];
        to[9] = sqrt(b->far[i]);
    }
}

/* references: (samples, 9), q, v, a; results: (n, 10), largest |e|, rms e, largest |tau|, largest distance;
 * histogram: (2, 1 + (samples - 1) / every, BINS), of distance and |e_psi|, zero before. Return 0, or 1 if
 * there is no memory. */
int ensemble(long n, long samples, long every, int threads, const Shared *all, const double *mass,
             const double *com, const double *references, double *results, int32_t *histogram) {
    const size_t kept = 1 + (samples - 1) / every, size = 2 * kept * BINS;
    const long blocks = (n + BLOCK - 1) / BLOCK;
    int failed = 0;
#pragma omp parallel num_threads(blocks < threads ? blocks : threads) reduction(| : failed)
    {
        int first_thread = omp_get_thread_num() == 0;
        int32_t *mine = first_thread ? histogram : calloc(size, sizeof *mine);
        failed |= mine == NULL;
#pragma omp for schedule(dynamic)
        for (long block = 0; block < blocks; block++) {
            if (!mine) continue;
            Block b;
            long first = block * BLOCK, real = n - first < BLOCK ? n - first : BLOCK;
            long count = (real + LANES - 1) / LANES * LANES;
            begin(&b, real, count, references, mass + first, com + first);
            for (long k = 0, next = 0; k < samples; k++) {
                turn(&b, count);
                if (k == next) {
                    control(&b, count, references + 9 * k, all, 1);
                    count_errors(&b, real, mine + k / every * BINS, mine + (kept + k / every) * BINS);
                    next += every;
                } else
                    control(&b, count, references + 9 * k, all, 0);
                if (k + 1 < samples) move(&b, count, all);
            }
            end(&b, real, samples, results + 10 * first);
        }
        if (mine && !first_thread) {
#pragma omp critical
            for (size_t i = 0; i < size; i++) histogram[i] += mine[i];
            free(mine);
        }
    }
    return failed;
}
