//! Sums of kernels.

use crate::{
    FormatError,
    map::{expect_finite, expect_positive, expect_shape, jet::Number},
};

/// One machine an output.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelMachines {
    /// In the order of the outputs.
    pub machines: Vec<KernelMachine>,
}

/// `y = bias + sum_c weights[c] * exp(-1/2 sum_i ((z_i - centres[c, i]) / lengths[i])^2)`.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelMachine {
    /// Length scale of each input, positive.
    pub lengths: Vec<f64>,
    /// Shape `[centres, inputs]`.
    pub centres: Vec<f64>,
    /// Shape `[centres]`.
    pub weights: Vec<f64>,
    /// Far from every centre.
    pub bias: f64,
}

impl KernelMachines {
    pub(super) fn check(&self, inputs: usize, outputs: usize) -> Result<(), FormatError> {
        expect_shape("kernel.bias", &[self.machines.len()], &[outputs])?;
        expect_finite("kernel.bias", self.machines.iter().map(|machine| machine.bias))?;
        for (output, machine) in self.machines.iter().enumerate() {
            let KernelMachine { lengths, centres, weights, .. } = machine;
            let name = |what: &str| format!("kernel.{output}.{what}");
            expect_shape(&name("lengths"), &[lengths.len()], &[inputs])?;
            expect_finite(&name("lengths"), lengths.iter().copied())?;
            expect_positive(&name("lengths"), lengths)?;
            expect_shape(&name("centres"), &[centres.len()], &[weights.len() * inputs])?;
            expect_finite(&name("centres"), centres.iter().copied())?;
            expect_finite(&name("weights"), weights.iter().copied())?;
        }
        Ok(())
    }

    pub(super) fn evaluate<N: Number>(&self, inputs: &[N], outputs: &mut [N]) {
        for (y, machine) in outputs.iter_mut().zip(&self.machines) {
            let centres = machine.centres.chunks_exact(inputs.len()).zip(&machine.weights);
            *y = centres.fold(N::from(machine.bias), |sum, (centre, &weight)| {
                let columns = inputs.iter().zip(centre).zip(&machine.lengths);
                let square = columns.fold(N::from(0.0), |square, ((&z, &centre), &length)| {
                    let distance = (z - N::from(centre)) * N::from(1.0 / length);
                    square + distance * distance
                });
                sum + N::from(weight) * (N::from(-0.5) * square).exp()
            });
        }
    }
}
