//! State spaces of discrete-time models: simulations with sensitivities, and least squares of their errors.
//!
//! ```text
//! x[k+1] = x[k] + L z[k] + c + G f(z[k]),    z = (x, u, p),    x = (y, h)
//! ```
//!
//! `x` are the states: outputs `y` and hidden states `h`. `u` are inputs and `p` parameters, all standardized. Functions `f` are none, products
//! of Legendre polynomials, or nodes `tanh(W z + b)`. Ranges of states and of sensors ([`Limits`]) and the correction by given outputs are part
//! of a simulation. [`CountedRuns::fit`] minimizes the squares of the errors of all simulated outputs by the method of Levenberg and Marquardt
//! (Nocedal, Wright (2006), section 10.3), with exact sensitivities.

mod features;
mod fit;
mod saturation;
mod simulate;

pub use features::{Features, SPAN};
pub use fit::{CountedRuns, Goal, Minimum};
pub use saturation::Saturation;
pub use simulate::{Limits, Signals, Simulated, StateShape, correct, overwriting, simulate};
