/*
 * Functions of FMI 3.0 for features that this FMU lacks: variables of types other than Float64, Int32 and Boolean,
 * clocks, structural parameters and model partitions. The standard requires all functions to exist.
 */
#include "calls_fmi3.h"
#include "fmi3.h"

static Status none(void *instance, const char *function, unsigned allowed, const char *type, size_t reference_count,
                   size_t value_count)
{
    if (!instance_begin(instance, function, allowed) ||
        instance_no_variables(instance, type, reference_count) != STATUS_OK ||
        instance_miscounts(instance, value_count, 0, "values")) {
        return STATUS_ERROR;
    }
    return STATUS_OK;
}

/* Refuses a call that no state allows. */
static Status never(void *instance, const char *function, unsigned allowed)
{
    instance_begin(instance, function, allowed);
    return STATUS_ERROR;
}

/* ---- Variables of other types ---- */

#define ABSENT(name, type, value, modifier) \
    Status fmi3Get##name(void *instance, const uint32_t valueReferences[], size_t nValueReferences, value values[], \
                         size_t nValues) \
    { \
        (void)valueReferences; \
        (void)values; \
        return none(instance, CALL(fmi3Get##name), type, nValueReferences, nValues); \
    } \
    Status fmi3Set##name(void *instance, const uint32_t valueReferences[], size_t nValueReferences, \
                         modifier values[], size_t nValues) \
    { \
        (void)valueReferences; \
        (void)values; \
        return none(instance, CALL(fmi3Set##name), type, nValueReferences, nValues); \
    }

ABSENT(Float32, "Float32", float, const float)
ABSENT(Int8, "Int8", int8_t, const int8_t)
ABSENT(UInt8, "UInt8", uint8_t, const uint8_t)
ABSENT(Int16, "Int16", int16_t, const int16_t)
ABSENT(UInt16, "UInt16", uint16_t, const uint16_t)
ABSENT(UInt32, "UInt32", uint32_t, const uint32_t)
ABSENT(Int64, "Int64", int64_t, const int64_t)
ABSENT(UInt64, "UInt64", uint64_t, const uint64_t)
ABSENT(String, "String", const char *, const char *const)

#define ABSENT_BINARY(name, size, value) \
    Status fmi3##name(void *instance, const uint32_t valueReferences[], size_t nValueReferences, size valueSizes[], \
                value values[], size_t nValues) \
    { \
        (void)valueReferences; \
        (void)valueSizes; \
        (void)values; \
        return none(instance, CALL(fmi3##name), "Binary", nValueReferences, nValues); \
    }

ABSENT_BINARY(GetBinary, size_t, const uint8_t *)
ABSENT_BINARY(SetBinary, const size_t, const uint8_t *const)

/* ---- Clocks ---- */

#define ABSENT_CLOCK(name, value) \
    Status fmi3##name(void *instance, const uint32_t valueReferences[], size_t nValueReferences, value values[]) \
    { \
        (void)valueReferences; \
        (void)values; \
        return none(instance, CALL(fmi3##name), "Clock", nValueReferences, 0); \
    }

ABSENT_CLOCK(GetClock, bool)
ABSENT_CLOCK(SetClock, const bool)
ABSENT_CLOCK(SetIntervalDecimal, const double)
ABSENT_CLOCK(GetShiftDecimal, double)
ABSENT_CLOCK(SetShiftDecimal, const double)

#define ABSENT_FRACTION(name, value) \
    Status fmi3##name(void *instance, const uint32_t valueReferences[], size_t nValueReferences, value counters[], \
                value resolutions[]) \
    { \
        (void)valueReferences; \
        (void)counters; \
        (void)resolutions; \
        return none(instance, CALL(fmi3##name), "Clock", nValueReferences, 0); \
    }

ABSENT_FRACTION(SetIntervalFraction, const uint64_t)
ABSENT_FRACTION(GetShiftFraction, uint64_t)
ABSENT_FRACTION(SetShiftFraction, const uint64_t)

Status fmi3GetIntervalDecimal(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                              double intervals[], fmi3IntervalQualifier qualifiers[])
{
    (void)valueReferences;
    (void)intervals;
    (void)qualifiers;
    return none(instance, CALL(fmi3GetIntervalDecimal), "Clock", nValueReferences, 0);
}

Status fmi3GetIntervalFraction(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                               uint64_t counters[], uint64_t resolutions[], fmi3IntervalQualifier qualifiers[])
{
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return none(instance, CALL(fmi3GetIntervalFraction), "Clock", nValueReferences, 0);
}

/* ---- Structural parameters, scheduled execution ---- */

Status fmi3EnterConfigurationMode(void *instance)
{
    return instance_begin(instance, CALL(fmi3EnterConfigurationMode)) ? STATUS_OK : STATUS_ERROR;
}

Status fmi3ExitConfigurationMode(void *instance)
{
    return instance_begin(instance, CALL(fmi3ExitConfigurationMode)) ? STATUS_OK : STATUS_ERROR;
}

Status fmi3ActivateModelPartition(void *instance, uint32_t clockReference, double activationTime)
{
    (void)clockReference;
    (void)activationTime;
    return never(instance, CALL(fmi3ActivateModelPartition));
}
