/*
 * The functions of FMI 3.0 for what the FMU does not have: variables of other types than Float64, Int32 and Boolean,
 * clocks, structural parameters and model partitions. They are there because the standard wants all functions.
 */
#include "fmi3.h"

/* The "allowed function calls" of sections 2.3, 3.2 and 4.2. */
enum {
    SET = ANY_INTERFACE | STATE_INSTANTIATED | STATE_INITIALIZATION | INITIALIZED | STATE_UPDATE,
    GET = SET | STATE_TERMINATED,
    CLOCK = ANY_INTERFACE | STATE_EVENT,
    INTERVAL = ANY_INTERFACE | STATE_INITIALIZATION | STATE_EVENT,
    SHIFT = ANY_INTERFACE | STATE_INITIALIZATION
};

static Status none(void *instance, const char *function, unsigned allowed, const char *type, size_t count)
{
    return instance_begin(instance, function, allowed) ? instance_no_variables(instance, type, count) : STATUS_ERROR;
}

static Status never(void *instance, const char *function)
{
    instance_begin(instance, function, NOWHERE);
    return STATUS_ERROR;
}

/* ---- Getting variables of other types ---- */

Status fmi3GetFloat32(void *instance, const uint32_t valueReferences[], size_t nValueReferences, float values[],
                      size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3GetFloat32", GET, "Float32", nValueReferences);
}

Status fmi3GetInt8(void *instance, const uint32_t valueReferences[], size_t nValueReferences, int8_t values[],
                   size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3GetInt8", GET, "Int8", nValueReferences);
}

Status fmi3GetUInt8(void *instance, const uint32_t valueReferences[], size_t nValueReferences, uint8_t values[],
                    size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3GetUInt8", GET, "UInt8", nValueReferences);
}

Status fmi3GetInt16(void *instance, const uint32_t valueReferences[], size_t nValueReferences, int16_t values[],
                    size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3GetInt16", GET, "Int16", nValueReferences);
}

Status fmi3GetUInt16(void *instance, const uint32_t valueReferences[], size_t nValueReferences, uint16_t values[],
                     size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3GetUInt16", GET, "UInt16", nValueReferences);
}

Status fmi3GetUInt32(void *instance, const uint32_t valueReferences[], size_t nValueReferences, uint32_t values[],
                     size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3GetUInt32", GET, "UInt32", nValueReferences);
}

Status fmi3GetInt64(void *instance, const uint32_t valueReferences[], size_t nValueReferences, int64_t values[],
                    size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3GetInt64", GET, "Int64", nValueReferences);
}

Status fmi3GetUInt64(void *instance, const uint32_t valueReferences[], size_t nValueReferences, uint64_t values[],
                     size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3GetUInt64", GET, "UInt64", nValueReferences);
}

Status fmi3GetString(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const char *values[],
                     size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3GetString", GET, "String", nValueReferences);
}

Status fmi3GetBinary(void *instance, const uint32_t valueReferences[], size_t nValueReferences, size_t valueSizes[],
                     const uint8_t *values[], size_t nValues)
{
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3GetBinary", GET, "Binary", nValueReferences);
}

/* ---- Setting variables of other types ---- */

Status fmi3SetFloat32(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const float values[],
                      size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3SetFloat32", SET, "Float32", nValueReferences);
}

Status fmi3SetInt8(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const int8_t values[],
                   size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3SetInt8", SET, "Int8", nValueReferences);
}

Status fmi3SetUInt8(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const uint8_t values[],
                    size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3SetUInt8", SET, "UInt8", nValueReferences);
}

Status fmi3SetInt16(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const int16_t values[],
                    size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3SetInt16", SET, "Int16", nValueReferences);
}

Status fmi3SetUInt16(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                     const uint16_t values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3SetUInt16", SET, "UInt16", nValueReferences);
}

Status fmi3SetUInt32(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                     const uint32_t values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3SetUInt32", SET, "UInt32", nValueReferences);
}

Status fmi3SetInt64(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const int64_t values[],
                    size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3SetInt64", SET, "Int64", nValueReferences);
}

Status fmi3SetUInt64(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                     const uint64_t values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3SetUInt64", SET, "UInt64", nValueReferences);
}

Status fmi3SetString(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                     const char *const values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3SetString", SET, "String", nValueReferences);
}

Status fmi3SetBinary(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                     const size_t valueSizes[], const uint8_t *const values[], size_t nValues)
{
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    (void)nValues;
    return none(instance, "fmi3SetBinary", SET, "Binary", nValueReferences);
}

/* ---- Clocks ---- */

Status fmi3GetClock(void *instance, const uint32_t valueReferences[], size_t nValueReferences, bool values[])
{
    (void)valueReferences;
    (void)values;
    return none(instance, "fmi3GetClock", CLOCK, "Clock", nValueReferences);
}

Status fmi3SetClock(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const bool values[])
{
    (void)valueReferences;
    (void)values;
    return none(instance, "fmi3SetClock", CLOCK, "Clock", nValueReferences);
}

Status fmi3GetIntervalDecimal(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                              double intervals[], int qualifiers[])
{
    (void)valueReferences;
    (void)intervals;
    (void)qualifiers;
    return none(instance, "fmi3GetIntervalDecimal", INTERVAL, "Clock", nValueReferences);
}

Status fmi3GetIntervalFraction(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                               uint64_t counters[], uint64_t resolutions[], int qualifiers[])
{
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return none(instance, "fmi3GetIntervalFraction", INTERVAL, "Clock", nValueReferences);
}

Status fmi3SetIntervalDecimal(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                              const double intervals[])
{
    (void)valueReferences;
    (void)intervals;
    return none(instance, "fmi3SetIntervalDecimal", INTERVAL, "Clock", nValueReferences);
}

Status fmi3SetIntervalFraction(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                               const uint64_t counters[], const uint64_t resolutions[])
{
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    return none(instance, "fmi3SetIntervalFraction", INTERVAL, "Clock", nValueReferences);
}

Status fmi3GetShiftDecimal(void *instance, const uint32_t valueReferences[], size_t nValueReferences, double shifts[])
{
    (void)valueReferences;
    (void)shifts;
    return none(instance, "fmi3GetShiftDecimal", SHIFT, "Clock", nValueReferences);
}

Status fmi3GetShiftFraction(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                            uint64_t counters[], uint64_t resolutions[])
{
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    return none(instance, "fmi3GetShiftFraction", SHIFT, "Clock", nValueReferences);
}

Status fmi3SetShiftDecimal(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                           const double shifts[])
{
    (void)valueReferences;
    (void)shifts;
    return none(instance, "fmi3SetShiftDecimal", SHIFT, "Clock", nValueReferences);
}

Status fmi3SetShiftFraction(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                            const uint64_t counters[], const uint64_t resolutions[])
{
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    return none(instance, "fmi3SetShiftFraction", SHIFT, "Clock", nValueReferences);
}

/* ---- Structural parameters, scheduled execution ---- */

Status fmi3EnterConfigurationMode(void *instance)
{
    return never(instance, "fmi3EnterConfigurationMode");
}

Status fmi3ExitConfigurationMode(void *instance)
{
    return never(instance, "fmi3ExitConfigurationMode");
}

Status fmi3ActivateModelPartition(void *instance, uint32_t clockReference, double activationTime)
{
    (void)clockReference;
    (void)activationTime;
    return never(instance, "fmi3ActivateModelPartition");
}
