/*
 * Numbers in which a model is computed: double precision or, with -DMETAFMU_SINGLE, single precision. All times and all
 * values of the FMI interface are in double precision.
 */
#ifndef REAL_H
#define REAL_H

#include <float.h>
#include <math.h>

#ifdef METAFMU_SINGLE

typedef float Real;
#define R(literal) literal##f
#define MATH(function) function##f
#define REAL_HUGE HUGE_VALF
#define REAL_EPSILON FLT_EPSILON

#else

typedef double Real;
#define R(literal) literal
#define MATH(function) function
#define REAL_HUGE HUGE_VAL
#define REAL_EPSILON DBL_EPSILON

#endif

#endif
