/* Bare C: a tanh network of 4 inputs, LAYERS hidden layers of HIDDEN nodes and 3 outputs in AVX-512 intrinsics, in single precision or, with -DDOUBLE, in double.
 *
 * RESOURCES is a folder with `bare.f32` or `bare.f64`: for each layer the weights, inputs by outputs, then the biases.
 */
#include "bare.h"
#include <immintrin.h>
#include <stdio.h>
#include <string.h>

#ifdef DOUBLE
typedef double Number;
typedef __m512d Vector;
#define V(name) _mm512_##name##_pd
#define FILE_NAME "bare.f64"
#define LANES 8
#else
typedef float Number;
typedef __m512 Vector;
#define V(name) _mm512_##name##_ps
#define FILE_NAME "bare.f32"
#define LANES 16
#endif
#define GROUPS (HIDDEN / LANES)
/* sixteen accumulators suffice for two multiply-add units and their latency: CHAINS inputs at a time for WIDE groups */
#define WIDE (GROUPS < 8 ? GROUPS : 8)
#define CHAINS (16 / WIDE)
_Static_assert(HIDDEN % CHAINS == 0 && GROUPS % WIDE == 0 && LAYERS > 0, "a multiple");

typedef struct {
    Number weight[HIDDEN][HIDDEN], bias[HIDDEN];
} Inner;
typedef struct {
    Number first[4][HIDDEN], first_bias[HIDDEN];
    Inner inner[LAYERS];
    Number last[3][HIDDEN], last_bias[3];
} Network;
/* one inner layer less than hidden layers; the array has one more, as C has no empty ones */
static Network network __attribute__((aligned(64)));

static void *prepare(const char *folder)
{
    static Number last[HIDDEN][3];
    char path[4096];
    snprintf(path, sizeof path, "%s/" FILE_NAME, folder);
    FILE *file = fopen(path, "rb");
    if (!file) return NULL;
    int fine = fread(network.first, sizeof network.first, 1, file) == 1;
    fine = fine && fread(network.first_bias, sizeof network.first_bias, 1, file) == 1;
    fine = fine && fread(network.inner, sizeof *network.inner, LAYERS - 1, file) == LAYERS - 1;
    fine = fine && fread(last, sizeof last, 1, file) == 1;
    fine = fine && fread(network.last_bias, sizeof network.last_bias, 1, file) == 1;
    fclose(file);
    for (int i = 0; i < HIDDEN; i++)
        for (int o = 0; o < 3; o++) network.last[o][i] = last[i][o];
    return fine ? &network : NULL;
}

/* (1 - t) / (1 + t) with t = exp(-2 |x|) = 2^n 2^r, |r| <= 1/2, and the sign of x */
static inline Vector activation(Vector x)
{
#ifdef DOUBLE
    /* Taylor, the first omitted term is below 1e-14 */
    static const double coefficients[] = {1.0 / 39916800, 1.0 / 3628800, 1.0 / 362880, 1.0 / 40320, 1.0 / 5040, 1.0 / 720,
                                          1.0 / 120, 1.0 / 24, 1.0 / 6, 0.5, 1.0, 1.0};
    const double unit = 0.6931471805599453;
#else
    static const float coefficients[] = {1.0f / 720, 1.0f / 120, 1.0f / 24, 1.0f / 6, 0.5f, 1.0f, 1.0f};
    const float unit = 0.69314718f;
#endif
    Vector a = V(mul)(V(abs)(x), V(set1)((Number)-2.8853900817779268));
    Vector n = V(roundscale)(a, 8), r = V(mul)(V(sub)(a, n), V(set1)(unit)), p = V(set1)(coefficients[0]);
    for (size_t i = 1; i < sizeof coefficients / sizeof *coefficients; i++) p = V(fmadd)(p, r, V(set1)(coefficients[i]));
    Vector t = V(scalef)(p, n), one = V(set1)((Number)1), sign = V(set1)((Number)-0.0);
    return V(or)(V(div)(V(sub)(one, t), V(add)(one, t)), V(and)(x, sign));
}

static int evaluate(void *unused, const double *inputs, double *outputs)
{
    Number values[2][HIDDEN] __attribute__((aligned(64)));
    (void)unused;
    for (int group = 0; group < GROUPS; group += WIDE) {
        Vector sum[WIDE];
        for (int j = 0; j < WIDE; j++) sum[j] = V(load)(network.first_bias + LANES * (group + j));
        for (int i = 0; i < 4; i++) {
            Vector x = V(set1)((Number)inputs[i]);
            for (int j = 0; j < WIDE; j++) sum[j] = V(fmadd)(x, V(load)(&network.first[i][LANES * (group + j)]), sum[j]);
        }
        for (int j = 0; j < WIDE; j++) V(store)(values[0] + LANES * (group + j), activation(sum[j]));
    }
    for (int layer = 0; layer + 1 < LAYERS; layer++) {
        const Inner *inner = &network.inner[layer];
        const Number *from = values[layer % 2];
        Number *to = values[1 - layer % 2];
        for (int group = 0; group < GROUPS; group += WIDE) {
            Vector sum[CHAINS][WIDE];
            for (int j = 0; j < WIDE; j++) {
                sum[0][j] = V(load)(inner->bias + LANES * (group + j));
                for (int c = 1; c < CHAINS; c++) sum[c][j] = V(setzero)();
            }
            for (int i = 0; i < HIDDEN; i += CHAINS)
                for (int c = 0; c < CHAINS; c++) {
                    Vector x = V(set1)(from[i + c]);
                    for (int j = 0; j < WIDE; j++)
                        sum[c][j] = V(fmadd)(x, V(load)(&inner->weight[i + c][LANES * (group + j)]), sum[c][j]);
                }
            for (int j = 0; j < WIDE; j++) {
                for (int c = 1; c < CHAINS; c++) sum[0][j] = V(add)(sum[0][j], sum[c][j]);
                V(store)(to + LANES * (group + j), activation(sum[0][j]));
            }
        }
    }
    const Number *hidden = values[(LAYERS - 1) % 2];
    for (int o = 0; o < 3; o++) {
        Vector sum = V(setzero)();
        for (int j = 0; j < GROUPS; j++) sum = V(fmadd)(V(load)(hidden + LANES * j), V(load)(&network.last[o][LANES * j]), sum);
        outputs[o] = (double)(V(reduce_add)(sum) + network.last_bias[o]);
    }
    return 0;
}
