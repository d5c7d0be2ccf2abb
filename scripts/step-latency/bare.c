/* Bare C: a 4-128-128-3 tanh network in AVX-512 intrinsics, in single precision or, with -DDOUBLE, in double.
 *
 * RESOURCES is a folder with `bare.f32` or `bare.f64`: for each layer the weights, inputs by outputs, then the biases.
 */
#include "bare.h"
#include <immintrin.h>
#include <stdio.h>
#include <string.h>

#define HIDDEN 128
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

typedef struct {
    Number first[4][HIDDEN], first_bias[HIDDEN], second[HIDDEN][HIDDEN], second_bias[HIDDEN], third[3][HIDDEN], third_bias[3];
} Network;
static Network network __attribute__((aligned(64)));

static void *prepare(const char *folder)
{
    static Number third[HIDDEN][3];
    char path[4096];
    snprintf(path, sizeof path, "%s/" FILE_NAME, folder);
    FILE *file = fopen(path, "rb");
    if (!file) return NULL;
    int fine = fread(network.first, sizeof network.first, 1, file) == 1;
    fine = fine && fread(network.first_bias, sizeof network.first_bias, 1, file) == 1;
    fine = fine && fread(network.second, sizeof network.second, 1, file) == 1;
    fine = fine && fread(network.second_bias, sizeof network.second_bias, 1, file) == 1;
    fine = fine && fread(third, sizeof third, 1, file) == 1;
    fine = fine && fread(network.third_bias, sizeof network.third_bias, 1, file) == 1;
    fclose(file);
    for (int i = 0; i < HIDDEN; i++)
        for (int o = 0; o < 3; o++) network.third[o][i] = third[i][o];
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
    Number hidden[HIDDEN] __attribute__((aligned(64)));
    Vector last[GROUPS];
    (void)unused;
    /* eight accumulators at a time, as many as the latency of two multiply-add units asks for */
    for (int group = 0; group < GROUPS; group += 8) {
        Vector sum[8];
        for (int j = 0; j < 8; j++) sum[j] = V(load)(network.first_bias + LANES * (group + j));
        for (int i = 0; i < 4; i++) {
            Vector x = V(set1)((Number)inputs[i]);
            for (int j = 0; j < 8; j++) sum[j] = V(fmadd)(x, V(load)(&network.first[i][LANES * (group + j)]), sum[j]);
        }
        for (int j = 0; j < 8; j++) V(store)(hidden + LANES * (group + j), activation(sum[j]));
    }
    for (int group = 0; group < GROUPS; group += 8) {
        Vector even[8], odd[8];
        for (int j = 0; j < 8; j++) {
            even[j] = V(load)(network.second_bias + LANES * (group + j));
            odd[j] = V(setzero)();
        }
        for (int i = 0; i < HIDDEN; i += 2) {
            Vector x = V(set1)(hidden[i]), y = V(set1)(hidden[i + 1]);
            for (int j = 0; j < 8; j++) even[j] = V(fmadd)(x, V(load)(&network.second[i][LANES * (group + j)]), even[j]);
            for (int j = 0; j < 8; j++) odd[j] = V(fmadd)(y, V(load)(&network.second[i + 1][LANES * (group + j)]), odd[j]);
        }
        for (int j = 0; j < 8; j++) last[group + j] = activation(V(add)(even[j], odd[j]));
    }
    for (int o = 0; o < 3; o++) {
        Vector sum = V(setzero)();
        for (int j = 0; j < GROUPS; j++) sum = V(fmadd)(last[j], V(load)(&network.third[o][LANES * j]), sum);
        outputs[o] = (double)(V(reduce_add)(sum) + network.third_bias[o]);
    }
    return 0;
}
