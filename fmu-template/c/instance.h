/*
 * One simulation of the surrogate: its states and its values. It depends on the FMI version only where the standards
 * differ; fmi2.c or fmi3.c translate a host's calls to calls of these functions.
 *
 * Instances share nothing, and there are no variables outside of instances: any number of threads may each have one.
 * Functions allocate no memory, unless their comment says so.
 */
#ifndef INSTANCE_H
#define INSTANCE_H

#include "evaluator.h"
#include <stdbool.h>

/*
 * Status of a call and severity of a message, with the numbers of fmi2Status and fmi3Status. No call returns a warning:
 * many hosts end a simulation on any status but OK.
 */
typedef enum {
    STATUS_OK,
    STATUS_WARNING,
    STATUS_DISCARD,
    STATUS_ERROR,
    STATUS_FATAL,  /* never returned */
    STATUS_PENDING /* FMI 2.0, never returned */
} Status;

/* Modes of the standard's state machines. The numbers are bits, for sets of states. */
typedef enum {
    STATE_INSTANTIATED = 1,
    STATE_INITIALIZATION = 2,
    STATE_EVENT = 4,
    STATE_CONTINUOUS_TIME = 8,
    STATE_STEP = 16,
    STATE_TERMINATED = 32,
    STATE_ERROR = 64, /* FMI 2.0, after the run has failed; FMI 3.0 has STATE_TERMINATED instead */
    STATE_UPDATE = 128 /* FMI 3.0, during a callback within a step; never saved */
} State;

/* Who advances the time: the FMU over a step, or a solver around it. The numbers are shifts of the sets of states below. */
typedef enum { CO_SIMULATION = 0, MODEL_EXCHANGE = 8 } Interface;

/* States that allow a call: a set for each interface. */
#define IN_CO_SIMULATION(states) ((states) << CO_SIMULATION)
#define IN_MODEL_EXCHANGE(states) ((states) << MODEL_EXCHANGE)
#define IN_BOTH(states) (IN_CO_SIMULATION(states) | IN_MODEL_EXCHANGE(states))

/* Two arguments: the name of a function of the standard, and the states that allow it, from calls_fmi2.h or calls_fmi3.h. */
#define CALL(function) #function, ALLOWED_##function

/* Values of the parameter domain_policy: what to do outside the training ranges. */
typedef enum { POLICY_WARN, POLICY_CLAMP, POLICY_ERROR } Policy;

/* Highest order of the time derivatives of outputs. */
enum { DERIVATIVE_ORDERS = 2 };

enum { MESSAGE_SIZE = 512 };

/* All data that a simulation needs to continue from a point. */
typedef struct {
    uint64_t fingerprint; /* of surrogate, FMI version and interface; other states are refused */
    State state;
    bool experiment; /* true if the start time is known */
    Policy policy;
    bool changed;      /* true if inputs or parameters changed during the run */
    double time;       /* s */
    double start_time; /* s */
    double stop_time;  /* s; infinite if none is defined */
    double tolerance;  /* of the solver inside the FMU, zero for steps of fixed size */
    double columns[COLUMN_COUNT]; /* inputs, then states or memory */
    double at_start[COLUMN_COUNT]; /* columns at the start of the run */
    double rates[DERIVATIVE_ORDERS][COLUMN_COUNT]; /* time derivatives of inputs, per s and per s^2 */
} Snapshot;

typedef struct Instance Instance;

/* Sends a message to the host. */
typedef void (*SendMessage)(const Instance *instance, Status status, const char *category, const char *message);

struct Instance {
    int fmi_version; /* 2 or 3 */
    Interface interface;
    bool event_mode; /* FMI 3.0 co-simulation: true if the host enters Event Mode between steps */
    SendMessage send;
    bool log_warnings; /* errors are always logged */
    bool log_everything;
    const char *function; /* present call, for messages */
    Snapshot now;
    double point[COLUMN_COUNT]; /* where the model is evaluated: columns, with inputs clamped under POLICY_CLAMP */
    double results[RESULT_COUNT]; /* outputs, then derivatives of states; valid unless stale */
    bool stale; /* true if something changed since the results were computed; they are updated on demand */
    double since; /* s; part of the communication step before the present step of the solver */
    bool warned[COLUMN_COUNT]; /* columns that caused a warning in this run */
    bool warned_of_change;     /* true after the warning that an input or parameter changed */
    bool warned_of_data;       /* true after the warning that no training data are near the inputs */
    size_t centre;             /* center of training data that was near last */
    unsigned trials; /* points that a solver has tried since it last completed a step, each later than all before */
    double furthest; /* s; the last of them */
    Scratch scratch;
};

/* ---- Instances and messages ---- */

/* Initializes an instance whose fields fmi_version, interface, event_mode, send and log_* are set. */
void instance_initialize(Instance *instance, const char *function);

/* Returns true if an instance can have this name, false after a message. */
bool instance_check_name(Instance *instance, const char *name);

/* Returns true if the argument is the token of this FMU, and the FMU has the interface; false after a message. */
bool instance_check_token(Instance *instance, const char *token, const char *argument);

/* Returns true if the state allows the call, false after a message. Every call begins with it. */
bool instance_begin(Instance *instance, const char *function, unsigned allowed);

/* Sends a message to the host, if its log settings include it. Returns the status. A call that is refused with an error changes nothing: the
 * instance continues if its host does. */
Status instance_tell(Instance *instance, Status status, const char *format, ...);

/* Sends a message as instance_tell does. After an error the run cannot go on. */
Status instance_end(Instance *instance, Status status, const char *format, ...);

/* Switches log categories; all of them if none is named. */
Status instance_switch_logging(Instance *instance, bool on, size_t count, const char *const categories[]);

/* Returns true, after a message, if an argument with elements is a null pointer. */
bool instance_lacks(Instance *instance, const void *pointer, size_t count, const char *argument);

/* Returns true, after a message, if the number of elements of an argument is not the expected one. */
bool instance_miscounts(Instance *instance, size_t found, size_t expected, const char *argument);

/* Refuses to get or set variables of a type that no variable has. */
Status instance_no_variables(Instance *instance, const char *type, size_t count);

/* ---- Modes ---- */

/* Sets up the experiment. The tolerance is for the solver inside the FMU, if it is defined. */
Status instance_set_up_experiment(Instance *instance, bool tolerance_defined, double tolerance, double start,
                                  bool stop_defined, double stop);
Status instance_enter_initialization_mode(Instance *instance);
Status instance_exit_initialization_mode(Instance *instance);
Status instance_enter_event_mode(Instance *instance);

/* Returns to the state after instantiation: start values, time zero. */
void instance_reset(Instance *instance);

/* ---- Values ---- */

Status instance_get_real(Instance *instance, const uint32_t references[], size_t count, double values[]);
Status instance_get_integer(Instance *instance, const uint32_t references[], size_t count, int32_t values[]);
/* Refuses references if one of them is not a Boolean, or cannot be read now. instance_boolean returns the value of each. */
Status instance_check_booleans(Instance *instance, const uint32_t references[], size_t count);
bool instance_boolean(const Instance *instance, uint32_t reference);
/* Sets inputs and parameters: all of them or, if one is refused, none. */
Status instance_set_real(Instance *instance, const uint32_t references[], size_t count, const double values[]);
Status instance_set_integer(Instance *instance, const uint32_t references[], size_t count, const int32_t values[]);
/* Refuses references if one of them is not a Boolean input. The only such input is use_measured, which instance_use_measured sets. */
Status instance_check_set_boolean(Instance *instance, const uint32_t references[], size_t count);
void instance_use_measured(Instance *instance, bool on);

/* Counts the variables that a variable depends on. */
Status instance_count_dependencies(Instance *instance, uint32_t reference, size_t *count);
/* Returns the i-th of them: all inputs and states, and the policy for outputs and derivatives of states. */
uint32_t instance_dependency(size_t i);

/* ---- Time ---- */

/*
 * Advances from the communication point `from` by `size`, in s.
 *
 * `from` must be where the last step ended: otherwise, the host and this instance disagree on the steps made. Such a
 * mistake is a large part of a step, unlike rounding, which some hosts do in single precision. It does not add up, as
 * the instance adopts the host's clock. The standard requires a positive size; zero is accepted.
 */
Status instance_do_step(Instance *instance, double from, double size);

/* Checks that such a step is allowed, apart from errors of the solver. */
Status instance_check_step(Instance *instance, double from, double size);

/* Returns the number of solver steps, of equal size, that call a host back in a communication step; one without states. */
double instance_updates(double size);

/* Checks that a variable exists, and otherwise reports it. All variables can be read in intermediate updates. */
Status instance_check_intermediate(Instance *instance, uint32_t reference);

/*
 * Sets the time of a solver around the FMU. It moves ahead and back, even past the stop time and shortly before the start: the FMU has no
 * events, so nothing in it depends on the way.
 */
Status instance_set_solver_time(Instance *instance, double time);

/* Accepts a point where a solver has completed a step, or an event begins: now the time and the inputs count. */
Status instance_accept_point(Instance *instance);

/* ---- Continuous states: STATE_COUNT values each ---- */

void instance_get_states(const Instance *instance, double states[]);
void instance_get_nominals(double nominals[]);
Status instance_get_derivatives(Instance *instance, double derivatives[]);

/* Sets states that a solver tries. */
Status instance_set_states(Instance *instance, const double states[]);

/* ---- Derivatives ---- */

/*
 * Computes sensitivity = J seed, with J the derivatives of the unknowns (outputs, states, their derivatives) with
 * respect to the knowns (inputs, parameters, states, time).
 */
Status instance_directional_derivative(Instance *instance, const uint32_t unknowns[], size_t unknown_count,
                                       const uint32_t knowns[], size_t known_count, const double seed[],
                                       double sensitivity[]);

/* Computes sensitivity = J^T seed. */
Status instance_adjoint_derivative(Instance *instance, const uint32_t unknowns[], size_t unknown_count,
                                   const uint32_t knowns[], size_t known_count, const double seed[],
                                   double sensitivity[]);

/* Computes derivatives of outputs with respect to time. Inputs follow the derivatives from the host. */
Status instance_output_derivatives(Instance *instance, const uint32_t references[], size_t count,
                                   const int32_t orders[], double values[]);

/* Sets time derivatives of inputs at the beginning of the next step. They stay until they are set again. */
Status instance_set_input_derivatives(Instance *instance, const uint32_t references[], size_t count,
                                      const int32_t orders[], const double values[]);

/* ---- State ---- */

/* Returns the number of bytes of a serialized state. */
size_t snapshot_size(void);

/* Copies the present state into `to`. */
void instance_save(const Instance *instance, Snapshot *to);

/* Continues from a state of any instance of this surrogate with the same FMI version and interface. */
Status instance_restore(Instance *instance, const Snapshot *from);

/* The bytes of a serialized state are the same on every machine. */
Status instance_serialize(Instance *instance, const Snapshot *from, uint8_t bytes[], size_t size);
Status instance_deserialize(Instance *instance, const uint8_t bytes[], size_t size, Snapshot *to);

#endif
