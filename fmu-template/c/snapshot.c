#include "parts.h"
#include <string.h>

/* FNV-1a, 64 bits: changing any single byte changes the hash. */
static uint64_t hash(uint64_t start, const uint8_t *bytes, size_t count)
{
    uint64_t result = start;
    for (size_t i = 0; i < count; i++) {
        result = (result ^ bytes[i]) * 0x100000001b3u;
    }
    return result;
}

static const uint64_t HASH_START = 0xcbf29ce484222325u;

uint64_t snapshot_fingerprint(const Instance *instance)
{
    const uint8_t kind[2] = {(uint8_t)instance->fmi_version, instance->interface == CO_SIMULATION ? 1 : 0};
    const uint64_t of_token = hash(HASH_START, (const uint8_t *)model_token, strlen(model_token));
    return hash(of_token, kind, sizeof kind);
}

/*
 * Serialized state:
 *
 *     - magic number with the version of this layout, fingerprint;
 *     - state, whether the experiment is set up, policy, whether inputs or parameters changed: a byte each;
 *     - time, start time, stop time, tolerance;
 *     - columns, columns at the start, first and second rates;
 *     - checksum of everything before.
 *
 * Numbers have 8 bytes, the lowest first.
 */
enum {
    NUMBER_SIZE = 8,
    MAGIC_SIZE = 8,
    FLAGS_SIZE = 4,
    NUMBERS = 4 + (2 + DERIVATIVE_ORDERS) * COLUMN_COUNT,
    CHECKED_SIZE = MAGIC_SIZE + NUMBER_SIZE + FLAGS_SIZE + NUMBERS * NUMBER_SIZE,
    SERIALIZED_SIZE = CHECKED_SIZE + NUMBER_SIZE
};

static const char MAGIC[MAGIC_SIZE + 1] = "metafmc\x04";

size_t snapshot_size(void)
{
    return SERIALIZED_SIZE;
}

void instance_save(const Instance *instance, Snapshot *to)
{
    *to = instance->now;
}

static Status foreign_state(Instance *instance)
{
    return instance_tell(instance, STATUS_ERROR,
                         "the state belongs to another FMU, or to another FMI version or interface of this one");
}

Status instance_restore(Instance *instance, const Snapshot *from)
{
    if (from->fingerprint != instance->now.fingerprint) {
        return foreign_state(instance);
    }
    instance->now = *from;
    instance->trials = 0;
    instance->furthest = instance->now.time;
    instance->stale = true;
    return STATUS_OK;
}

static uint8_t *put_integer(uint8_t *to, uint64_t value)
{
    for (unsigned i = 0; i < NUMBER_SIZE; i++) {
        to[i] = (uint8_t)(value >> (8 * i) & 0xff);
    }
    return to + NUMBER_SIZE;
}

static uint64_t integer_at(const uint8_t *from)
{
    uint64_t value = 0;
    for (unsigned i = 0; i < NUMBER_SIZE; i++) {
        value |= (uint64_t)from[i] << (8 * i);
    }
    return value;
}

static uint8_t *put_reals(uint8_t *to, const double *values, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        uint64_t bits;
        memcpy(&bits, &values[i], sizeof bits);
        to = put_integer(to, bits);
    }
    return to;
}

static const uint8_t *take_reals(const uint8_t *from, double *values, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        const uint64_t bits = integer_at(from);
        memcpy(&values[i], &bits, sizeof bits);
        from += NUMBER_SIZE;
    }
    return from;
}

static bool has_wrong_size(Instance *instance, size_t size)
{
    if (size == SERIALIZED_SIZE) {
        return false;
    }
    instance_tell(instance, STATUS_ERROR, "serialized state of %lu bytes, expected %lu", (unsigned long)size,
                  (unsigned long)SERIALIZED_SIZE);
    return true;
}

Status instance_serialize(Instance *instance, const Snapshot *from, uint8_t bytes[], size_t size)
{
    uint8_t *to = bytes;
    if (has_wrong_size(instance, size) || instance_lacks(instance, bytes, size, "serializedState")) {
        return STATUS_ERROR;
    }
    memcpy(to, MAGIC, MAGIC_SIZE);
    to = put_integer(to + MAGIC_SIZE, from->fingerprint);
    *to++ = (uint8_t)from->state;
    *to++ = from->experiment ? 1 : 0;
    *to++ = (uint8_t)from->policy;
    *to++ = from->changed ? 1 : 0;
    to = put_reals(to, &from->time, 1);
    to = put_reals(to, &from->start_time, 1);
    to = put_reals(to, &from->stop_time, 1);
    to = put_reals(to, &from->tolerance, 1);
    to = put_reals(to, from->columns, COLUMN_COUNT);
    to = put_reals(to, from->at_start, COLUMN_COUNT);
    to = put_reals(to, from->rates[0], COLUMN_COUNT);
    to = put_reals(to, from->rates[1], COLUMN_COUNT);
    put_integer(to, hash(HASH_START, bytes, CHECKED_SIZE));
    return STATUS_OK;
}

static Status damaged_state(Instance *instance, const char *reason)
{
    return instance_tell(instance, STATUS_ERROR, "serialized state is damaged or foreign: %s", reason);
}

static bool is_state(unsigned number)
{
    for (unsigned state = STATE_INSTANTIATED; state <= STATE_ERROR; state *= 2) {
        if (number == state) {
            return true;
        }
    }
    return false;
}

Status instance_deserialize(Instance *instance, const uint8_t bytes[], size_t size, Snapshot *to)
{
    if (size < MAGIC_SIZE || memcmp(bytes, MAGIC, MAGIC_SIZE) != 0) {
        return damaged_state(instance, "it does not begin with the magic number and version");
    }
    if (size < MAGIC_SIZE + NUMBER_SIZE) {
        return damaged_state(instance, "it is cut short");
    }
    /* before the size, to report a state of another surrogate as such */
    if (integer_at(bytes + MAGIC_SIZE) != instance->now.fingerprint) {
        return foreign_state(instance);
    }
    if (has_wrong_size(instance, size)) {
        return STATUS_ERROR;
    }
    if (integer_at(bytes + CHECKED_SIZE) != hash(HASH_START, bytes, CHECKED_SIZE)) {
        return damaged_state(instance, "the checksum does not match");
    }
    const uint8_t *from = bytes + MAGIC_SIZE + NUMBER_SIZE;
    if (!is_state(from[0])) {
        return damaged_state(instance, "it names no state");
    }
    if (from[2] > POLICY_ERROR) {
        return damaged_state(instance, "it names no domain policy");
    }
    to->fingerprint = instance->now.fingerprint;
    to->state = (State)from[0];
    to->experiment = from[1] != 0;
    to->policy = (Policy)from[2];
    to->changed = from[3] != 0;
    from = take_reals(from + FLAGS_SIZE, &to->time, 1);
    from = take_reals(from, &to->start_time, 1);
    from = take_reals(from, &to->stop_time, 1);
    from = take_reals(from, &to->tolerance, 1);
    from = take_reals(from, to->columns, COLUMN_COUNT);
    from = take_reals(from, to->at_start, COLUMN_COUNT);
    from = take_reals(from, to->rates[0], COLUMN_COUNT);
    take_reals(from, to->rates[1], COLUMN_COUNT);
    return STATUS_OK;
}
