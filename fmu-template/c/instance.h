/*
 * One simulation of the surrogate: the states it goes through and its values. It knows of the FMI version only where
 * the standards differ; fmi2.c or fmi3.c turn a host's calls into calls of these functions.
 *
 * An instance shares nothing with another one, and there are no variables outside of instances: any number of threads
 * may each have their own. No function but those that say so allocates memory.
 */
#ifndef INSTANCE_H
#define INSTANCE_H

#include "evaluator.h"
#include <stdbool.h>

/*
 * Status of a call and severity of a message; the numbers of fmi2Status and fmi3Status. No call returns a warning: many
 * hosts end a simulation on every status but OK.
 */
typedef enum { STATUS_OK, STATUS_WARNING, STATUS_DISCARD, STATUS_ERROR } Status;

/* The modes of the standard's state machines. Numbers are bits, for sets of states. */
typedef enum {
    STATE_INSTANTIATED = 1,
    STATE_INITIALIZATION = 2,
    STATE_EVENT = 4,
    STATE_CONTINUOUS_TIME = 8,
    STATE_STEP = 16,
    STATE_TERMINATED = 32,
    STATE_ERROR = 64, /* FMI 2.0, after a call was refused; in FMI 3.0 this is STATE_TERMINATED */
    STATE_UPDATE = 128 /* FMI 3.0, within a step, while the host is called back; no state that is saved */
} State;

/* Who advances the time: the FMU over a step, or a solver around it. Numbers are shifts of states below. */
typedef enum { CO_SIMULATION = 0, MODEL_EXCHANGE = 8 } Interface;

/* Where a call is allowed: a set of states for each interface. */
#define IN_CO_SIMULATION(states) ((states) << CO_SIMULATION)
#define IN_MODEL_EXCHANGE(states) ((states) << MODEL_EXCHANGE)
#define IN_BOTH(states) (IN_CO_SIMULATION(states) | IN_MODEL_EXCHANGE(states))

/* Two arguments: the name of a function of the standard and where it is allowed, of calls_fmi2.h or calls_fmi3.h. */
#define CALL(function) #function, ALLOWED_##function

/* Values of the parameter domain_policy: what to do outside the training ranges. */
typedef enum { POLICY_WARN, POLICY_CLAMP, POLICY_ERROR } Policy;

/* Highest order of the outputs' derivatives with respect to time. */
enum { DERIVATIVE_ORDERS = 2 };

enum { MESSAGE_SIZE = 512 };

/* Everything that a simulation needs to continue from a point. */
typedef struct {
    uint64_t fingerprint; /* of surrogate, FMI version and interface: other states are refused */
    State state;
    bool experiment; /* whether the start time is known */
    Policy policy;
    bool changed;      /* whether inputs or parameters were changed during the run */
    double time;       /* s */
    double start_time; /* s */
    double stop_time;  /* s; infinite if none is defined */
    double earliest;   /* s; where a solver may go back to: the start time or the last event */
    double tolerance;  /* of the solver inside the FMU; zero for steps of fixed size */
    double columns[COLUMN_COUNT]; /* inputs, then states or what is remembered */
    double at_start[COLUMN_COUNT]; /* columns at the start of the run */
    double rates[DERIVATIVE_ORDERS][COLUMN_COUNT]; /* time derivatives of inputs, per s and per s^2 */
} Snapshot;

typedef struct Instance Instance;

/* Gives a message to the host. */
typedef void (*SendMessage)(const Instance *instance, Status status, const char *category, const char *message);

struct Instance {
    int fmi_version; /* 2 or 3 */
    Interface interface;
    bool event_mode; /* FMI 3.0 co-simulation: whether the host enters Event Mode between steps */
    SendMessage send;
    bool log_warnings; /* errors are always logged */
    bool log_everything;
    const char *function; /* the call at hand, for messages */
    Snapshot now;
    double point[COLUMN_COUNT]; /* where the model is evaluated: inputs, clamped if that is the policy, and the rest */
    double results[RESULT_COUNT]; /* outputs, then derivatives of states; valid unless stale */
    bool stale; /* whether something changed since the results were computed; they are, when somebody asks */
    double since; /* s; how much of the communication step was made before the present one of the solver */
    bool warned[COLUMN_COUNT]; /* columns the host was told of in this run */
    bool warned_of_change;     /* whether it was told that an input or parameter changed */
    bool warned_of_data;       /* whether it was told that there are no training data near the inputs */
    size_t centre;             /* which part of the training data was near last */
    Scratch scratch;
};

/* ---- Instances and messages ---- */

/* Makes an instance of memory whose fields version, interface, event_mode, send and log_* are set. */
void instance_initialize(Instance *instance, const char *function);

/* Returns true if an instance can have this name, false after a message. */
bool instance_check_name(Instance *instance, const char *name);

/* Returns true if the token, an argument, is that of this FMU, which then can have this interface; false after a message. */
bool instance_check_token(Instance *instance, const char *token, const char *argument);

/* Returns true if the state allows the call, false after a message. First in every call. */
bool instance_begin(Instance *instance, const char *function, unsigned allowed);

/* Tells the host something if it wants to know. Returns the status; after an error the simulation cannot continue. */
Status instance_tell(Instance *instance, Status status, const char *format, ...);

/* Switches log categories, all if none is named. */
Status instance_switch_logging(Instance *instance, bool on, size_t count, const char *const categories[]);

/* Whether an argument is a null pointer though it has elements; the host is told. */
bool instance_lacks(Instance *instance, const void *pointer, size_t count, const char *argument);

/* Whether an argument has another number of elements than expected; the host is told. */
bool instance_miscounts(Instance *instance, size_t found, size_t expected, const char *argument);

/* Refuses to get or set variables of a type that no variable has. */
Status instance_no_variables(Instance *instance, const char *type, size_t count);

/* ---- Modes ---- */

/* The tolerance is that of the solver inside the FMU, if it is to have one. */
Status instance_set_up_experiment(Instance *instance, bool tolerance_defined, double tolerance, double start,
                                  bool stop_defined, double stop);
Status instance_enter_initialization_mode(Instance *instance);
Status instance_exit_initialization_mode(Instance *instance);
Status instance_enter_event_mode(Instance *instance);

/* As after instantiation: start values, time zero. */
void instance_reset(Instance *instance);

/* ---- Values ---- */

Status instance_get_real(Instance *instance, const uint32_t references[], size_t count, double values[]);
Status instance_get_integer(Instance *instance, const uint32_t references[], size_t count, int32_t values[]);
/* Refuses references of Booleans of which one is none, or cannot be read now. The value of each is that of the second function. */
Status instance_check_booleans(Instance *instance, const uint32_t references[], size_t count);
bool instance_boolean(const Instance *instance, uint32_t reference);
/* Sets inputs and parameters: all of them or, if one is refused, none. */
Status instance_set_real(Instance *instance, const uint32_t references[], size_t count, const double values[]);
Status instance_set_integer(Instance *instance, const uint32_t references[], size_t count, const int32_t values[]);
/* Refuses references of Booleans of which one is no input. The only such input is use_measured, which the second function sets. */
Status instance_check_set_boolean(Instance *instance, const uint32_t references[], size_t count);
void instance_use_measured(Instance *instance, bool on);

/* Number of the variables that a variable depends on. */
Status instance_count_dependencies(Instance *instance, uint32_t reference, size_t *count);
/* The i-th of them: all inputs and states, and for outputs and derivatives of states the policy. */
uint32_t instance_dependency(size_t i);

/* ---- Time ---- */

/*
 * From the communication point `from` on by `size`, in s.
 *
 * `from` must be where the last step ended, or the host and this instance disagree on which steps were made. Such a
 * mistake is off by a good part of a step, rounding is not: 1e-6 of the step and 1e-9 of the time are let pass. They do
 * not add up, as the host's clock is adopted. The standard asks for a positive size; zero is accepted.
 */
Status instance_do_step(Instance *instance, double from, double size);

/* Whether such a step may be made, but for what the solver finds. */
Status instance_check_step(Instance *instance, double from, double size);

/* Steps of the solver, of equal size, after which a host is called back in a communication step; one without states. */
double instance_updates(double size);

/* Whether a variable exists: all can be read in intermediate updates. The host is told if not. */
Status instance_check_intermediate(Instance *instance, uint32_t reference);

/* Time of a solver around the FMU. It looks ahead and back, even past the stop time, but not across an event. */
Status instance_set_solver_time(Instance *instance, double time);

/* Where a solver has completed a step or an event begins: now the time and the inputs count. */
Status instance_accept_point(Instance *instance);

/* ---- Continuous states: STATE_COUNT values each ---- */

void instance_get_states(const Instance *instance, double states[]);
void instance_get_nominals(double nominals[]);
Status instance_get_derivatives(Instance *instance, double derivatives[]);

/* States that a solver tries. */
Status instance_set_states(Instance *instance, const double states[]);

/* ---- Derivatives ---- */

/*
 * sensitivity = J seed, J the derivatives of the unknowns (outputs, states, their derivatives) with respect to the
 * knowns (inputs, parameters, states, time).
 */
Status instance_directional_derivative(Instance *instance, const uint32_t unknowns[], size_t unknown_count,
                                       const uint32_t knowns[], size_t known_count, const double seed[],
                                       double sensitivity[]);

/* sensitivity = J^T seed */
Status instance_adjoint_derivative(Instance *instance, const uint32_t unknowns[], size_t unknown_count,
                                   const uint32_t knowns[], size_t known_count, const double seed[],
                                   double sensitivity[]);

/* Derivatives of outputs with respect to time, inputs following the derivatives that the host gave. */
Status instance_output_derivatives(Instance *instance, const uint32_t references[], size_t count,
                                   const int32_t orders[], double values[]);

/* Time derivatives of inputs at the beginning of the next step. They stay until they are set again. */
Status instance_set_input_derivatives(Instance *instance, const uint32_t references[], size_t count,
                                      const int32_t orders[], const double values[]);

/* ---- State ---- */

/* Number of bytes of a serialized state. */
size_t snapshot_size(void);

/* Puts the present state into `to`. */
void instance_save(const Instance *instance, Snapshot *to);

/* Goes on from a state of any instance of this surrogate, made by the same FMI version and interface. */
Status instance_restore(Instance *instance, const Snapshot *from);

/* The bytes are the same on every machine. */
Status instance_serialize(Instance *instance, const Snapshot *from, uint8_t bytes[], size_t size);
Status instance_deserialize(Instance *instance, const uint8_t bytes[], size_t size, Snapshot *to);

#endif
