/*
 * The functions of FMI 3.0 for what the FMU does not have: variables of other types than Float64, Int32 and Boolean,
 * clocks, structural parameters and model partitions. They are there because the standard wants all functions.
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

/* For calls that no state allows. */
static Status never(void *instance, const char *function, unsigned allowed)
{
    instance_begin(instance, function, allowed);
    return STATUS_ERROR;
}

/* ---- Getting variables of other types ---- */

Status fmi3GetFloat32(void *instance, const uint32_t valueReferences[], size_t nValueReferences, float values[],
                      size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3GetFloat32), "Float32", nValueReferences, nValues);
}

Status fmi3GetInt8(void *instance, const uint32_t valueReferences[], size_t nValueReferences, int8_t values[],
                   size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3GetInt8), "Int8", nValueReferences, nValues);
}

Status fmi3GetUInt8(void *instance, const uint32_t valueReferences[], size_t nValueReferences, uint8_t values[],
                    size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3GetUInt8), "UInt8", nValueReferences, nValues);
}

Status fmi3GetInt16(void *instance, const uint32_t valueReferences[], size_t nValueReferences, int16_t values[],
                    size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3GetInt16), "Int16", nValueReferences, nValues);
}

Status fmi3GetUInt16(void *instance, const uint32_t valueReferences[], size_t nValueReferences, uint16_t values[],
                     size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3GetUInt16), "UInt16", nValueReferences, nValues);
}

Status fmi3GetUInt32(void *instance, const uint32_t valueReferences[], size_t nValueReferences, uint32_t values[],
                     size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3GetUInt32), "UInt32", nValueReferences, nValues);
}

Status fmi3GetInt64(void *instance, const uint32_t valueReferences[], size_t nValueReferences, int64_t values[],
                    size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3GetInt64), "Int64", nValueReferences, nValues);
}

Status fmi3GetUInt64(void *instance, const uint32_t valueReferences[], size_t nValueReferences, uint64_t values[],
                     size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3GetUInt64), "UInt64", nValueReferences, nValues);
}

Status fmi3GetString(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const char *values[],
                     size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3GetString), "String", nValueReferences, nValues);
}

Status fmi3GetBinary(void *instance, const uint32_t valueReferences[], size_t nValueReferences, size_t valueSizes[],
                     const uint8_t *values[], size_t nValues)
{
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    return none(instance, CALL(fmi3GetBinary), "Binary", nValueReferences, nValues);
}

/* ---- Setting variables of other types ---- */

Status fmi3SetFloat32(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const float values[],
                      size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3SetFloat32), "Float32", nValueReferences, nValues);
}

Status fmi3SetInt8(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const int8_t values[],
                   size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3SetInt8), "Int8", nValueReferences, nValues);
}

Status fmi3SetUInt8(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const uint8_t values[],
                    size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3SetUInt8), "UInt8", nValueReferences, nValues);
}

Status fmi3SetInt16(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const int16_t values[],
                    size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3SetInt16), "Int16", nValueReferences, nValues);
}

Status fmi3SetUInt16(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                     const uint16_t values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3SetUInt16), "UInt16", nValueReferences, nValues);
}

Status fmi3SetUInt32(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                     const uint32_t values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3SetUInt32), "UInt32", nValueReferences, nValues);
}

Status fmi3SetInt64(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const int64_t values[],
                    size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3SetInt64), "Int64", nValueReferences, nValues);
}

Status fmi3SetUInt64(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                     const uint64_t values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3SetUInt64), "UInt64", nValueReferences, nValues);
}

Status fmi3SetString(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                     const char *const values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3SetString), "String", nValueReferences, nValues);
}

Status fmi3SetBinary(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                     const size_t valueSizes[], const uint8_t *const values[], size_t nValues)
{
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    return none(instance, CALL(fmi3SetBinary), "Binary", nValueReferences, nValues);
}

/* ---- Clocks ---- */

Status fmi3GetClock(void *instance, const uint32_t valueReferences[], size_t nValueReferences, bool values[])
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3GetClock), "Clock", nValueReferences, 0);
}

Status fmi3SetClock(void *instance, const uint32_t valueReferences[], size_t nValueReferences, const bool values[])
{
    (void)valueReferences;
    (void)values;
    return none(instance, CALL(fmi3SetClock), "Clock", nValueReferences, 0);
}

Status fmi3GetIntervalDecimal(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                              double intervals[], int qualifiers[])
{
    (void)valueReferences;
    (void)intervals;
    (void)qualifiers;
    return none(instance, CALL(fmi3GetIntervalDecimal), "Clock", nValueReferences, 0);
}

Status fmi3GetIntervalFraction(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                               uint64_t counters[], uint64_t resolutions[], int qualifiers[])
{
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return none(instance, CALL(fmi3GetIntervalFraction), "Clock", nValueReferences, 0);
}

Status fmi3SetIntervalDecimal(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                              const double intervals[])
{
    (void)valueReferences;
    (void)intervals;
    return none(instance, CALL(fmi3SetIntervalDecimal), "Clock", nValueReferences, 0);
}

Status fmi3SetIntervalFraction(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                               const uint64_t counters[], const uint64_t resolutions[])
{
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    return none(instance, CALL(fmi3SetIntervalFraction), "Clock", nValueReferences, 0);
}

Status fmi3GetShiftDecimal(void *instance, const uint32_t valueReferences[], size_t nValueReferences, double shifts[])
{
    (void)valueReferences;
    (void)shifts;
    return none(instance, CALL(fmi3GetShiftDecimal), "Clock", nValueReferences, 0);
}

Status fmi3GetShiftFraction(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                            uint64_t counters[], uint64_t resolutions[])
{
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    return none(instance, CALL(fmi3GetShiftFraction), "Clock", nValueReferences, 0);
}

Status fmi3SetShiftDecimal(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                           const double shifts[])
{
    (void)valueReferences;
    (void)shifts;
    return none(instance, CALL(fmi3SetShiftDecimal), "Clock", nValueReferences, 0);
}

Status fmi3SetShiftFraction(void *instance, const uint32_t valueReferences[], size_t nValueReferences,
                            const uint64_t counters[], const uint64_t resolutions[])
{
    (void)valueReferences;
    (void)counters;
    (void)resolutions;
    return none(instance, CALL(fmi3SetShiftFraction), "Clock", nValueReferences, 0);
}

/* ---- Structural parameters, scheduled execution ---- */

Status fmi3EnterConfigurationMode(void *instance)
{
    return never(instance, CALL(fmi3EnterConfigurationMode));
}

Status fmi3ExitConfigurationMode(void *instance)
{
    return never(instance, CALL(fmi3ExitConfigurationMode));
}

Status fmi3ActivateModelPartition(void *instance, uint32_t clockReference, double activationTime)
{
    (void)clockReference;
    (void)activationTime;
    return never(instance, CALL(fmi3ActivateModelPartition));
}
