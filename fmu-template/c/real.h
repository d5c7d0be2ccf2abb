/*
 * The numbers that a model is computed in: double precision or, with -DMETAFMU_SINGLE, single precision. What the
 * interface of FMI shows and all times are in double precision always.
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
