//! Everything a simulation needs to go on from a point, in memory and as bytes.
//!
//! | bytes | |
//! |---|---|
//! | 8 | magic `metafmu` and the version of this layout |
//! | 8 | fingerprint of the surrogate, the FMI version and the interface |
//! | 1 | state |
//! | 1 | whether the experiment is set up |
//! | 1 | domain policy |
//! | 1 | whether inputs or parameters were changed during the run |
//! | 8 | time |
//! | 8 | start time |
//! | 8 | stop time |
//! | 8 | tolerance |
//! | 8 each | values of the columns: inputs, then states |
//! | 8 each | their values at the start of the run |
//! | 8 each | their first derivatives |
//! | 8 each | their second derivatives |
//! | 8 | checksum of all before |
//!
//! Numbers are little-endian.

use crate::{state::InstanceState, status::Refusal};
use metafmu_runtime::DomainPolicy;

/// The mutable part of an instance, but for values that can be computed from it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Snapshot {
    /// [`fingerprint`] of the instantiation token, the FMI version and the interface: other states are refused.
    pub surrogate: u64,
    pub state: InstanceState,
    /// `true` if the start time is known.
    pub experiment: bool,
    pub policy: DomainPolicy,
    /// `true` if inputs or parameters changed during the run.
    pub changed: bool,
    pub time: f64,
    pub start_time: f64,
    /// Infinite if none is defined.
    pub stop_time: f64,
    /// Tolerance of the solver inside the FMU; zero for steps of fixed size. The solver restarts at each communication
    /// point, so nothing else of it is part of the snapshot.
    pub tolerance: f64,
    /// One value for each input of the model, the time among them, and one for each state.
    pub values: Vec<f64>,
    /// Values when the run began to advance from its start time.
    pub at_start: Vec<f64>,
    /// First and second derivatives with respect to time of the columns that are inputs, zero for others.
    pub rates: [Vec<f64>; 2],
}

const MAGIC: [u8; 8] = *b"metafmu\x04";

/// All but the values, those at the start and their derivatives.
const FIXED_SIZE: usize = 8 + 8 + 4 + 4 * 8 + 8;

impl Snapshot {
    /// Becomes another one of the same surrogate. Does not allocate.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        let Self { values, at_start, rates: [first, second], .. } = self;
        values.copy_from_slice(&other.values);
        at_start.copy_from_slice(&other.at_start);
        first.copy_from_slice(&other.rates[0]);
        second.copy_from_slice(&other.rates[1]);
        self.surrogate = other.surrogate;
        self.state = other.state;
        self.experiment = other.experiment;
        self.policy = other.policy;
        self.changed = other.changed;
        self.time = other.time;
        self.start_time = other.start_time;
        self.stop_time = other.stop_time;
        self.tolerance = other.tolerance;
    }

    /// Number of bytes [`Snapshot::to_bytes`] gives.
    pub(crate) fn size(&self) -> usize {
        FIXED_SIZE + 4 * 8 * self.values.len()
    }

    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.size());
        bytes.extend(MAGIC);
        bytes.extend(self.surrogate.to_le_bytes());
        bytes.push(self.state as u8);
        bytes.push(self.experiment.into());
        bytes.push(self.policy as u8);
        bytes.push(self.changed.into());
        let times = [self.time, self.start_time, self.stop_time, self.tolerance];
        let columns = self.values.iter().chain(&self.at_start).chain(self.rates.iter().flatten());
        for number in times.iter().chain(columns) {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend(fingerprint(&bytes).to_le_bytes());
        bytes
    }

    /// Reads what [`Snapshot::to_bytes`] wrote for the surrogate that `like` is of.
    ///
    /// # Errors
    /// [`Refusal::StateSize`], [`Refusal::DamagedState`] or [`Refusal::ForeignState`].
    pub(crate) fn from_bytes(bytes: &[u8], like: &Self) -> Result<Self, Refusal> {
        if bytes.get(..MAGIC.len()) != Some(&MAGIC) {
            return Err(damaged("it does not begin with the magic number and version"));
        }
        // the fingerprint before the size, so that a state of another surrogate is called that
        let mut numbers = bytes[MAGIC.len()..].iter().copied();
        let surrogate = u64::from_le_bytes(take(&mut numbers)?);
        if surrogate != like.surrogate {
            return Err(Refusal::ForeignState);
        }
        if bytes.len() != like.size() {
            return Err(Refusal::StateSize { found: bytes.len(), expected: like.size() });
        }
        let [state, experiment, policy, changed] = take(&mut numbers)?;
        let time = take_number(&mut numbers)?;
        let start_time = take_number(&mut numbers)?;
        let stop_time = take_number(&mut numbers)?;
        let tolerance = take_number(&mut numbers)?;
        let count = like.values.len();
        let values = take_numbers(&mut numbers, count)?;
        let at_start = take_numbers(&mut numbers, count)?;
        let rates = [take_numbers(&mut numbers, count)?, take_numbers(&mut numbers, count)?];
        if u64::from_le_bytes(take(&mut numbers)?) != fingerprint(&bytes[..bytes.len() - 8]) {
            return Err(damaged("the checksum does not match"));
        }
        let state = InstanceState::from_number(state).ok_or_else(|| damaged("it names no state"))?;
        let policy = DomainPolicy::from_number(policy.into()).ok_or_else(|| damaged("it names no domain policy"))?;
        Ok(Self {
            surrogate,
            state,
            experiment: experiment != 0,
            policy,
            changed: changed != 0,
            time,
            start_time,
            stop_time,
            tolerance,
            values,
            at_start,
            rates,
        })
    }
}

fn take<const N: usize>(bytes: &mut impl Iterator<Item = u8>) -> Result<[u8; N], Refusal> {
    let mut taken = [0; N];
    for byte in &mut taken {
        *byte = bytes.next().ok_or(Refusal::DamagedState { reason: "it is cut short" })?;
    }
    Ok(taken)
}

fn take_number(bytes: &mut impl Iterator<Item = u8>) -> Result<f64, Refusal> {
    take(bytes).map(f64::from_le_bytes)
}

fn take_numbers(bytes: &mut impl Iterator<Item = u8>, count: usize) -> Result<Vec<f64>, Refusal> {
    (0..count).map(|_| take_number(bytes)).collect()
}

fn damaged(reason: &'static str) -> Refusal {
    Refusal::DamagedState { reason }
}

/// FNV-1a, 64 bits: any change of a single byte changes it.
pub(crate) fn fingerprint(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, &byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn snapshot() -> Snapshot {
        Snapshot {
            surrogate: fingerprint(b"token"),
            state: InstanceState::Step,
            experiment: true,
            policy: DomainPolicy::Clamp,
            changed: true,
            time: 0.1 + 0.2,
            start_time: 0.1,
            stop_time: f64::INFINITY,
            tolerance: 1e-7,
            values: vec![1e-300, -0.0, 0.1 + 0.2],
            at_start: vec![1e-300, 0.0, 0.1],
            rates: [vec![0.0, 1.0, 2.0], vec![3.0, 4.0, 5.0]],
        }
    }

    #[test]
    fn bytes_give_the_snapshot_back_to_the_last_bit() {
        let bytes = snapshot().to_bytes();
        assert_eq!(bytes.len(), snapshot().size());
        let again = Snapshot::from_bytes(&bytes, &snapshot()).unwrap();
        assert_eq!(again, snapshot());
        assert!(again.values[1].is_sign_negative());
    }

    #[test]
    fn no_byte_can_be_changed_and_no_part_cut_off_unnoticed() {
        let bytes = snapshot().to_bytes();
        for position in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[position] ^= 0x10;
            assert!(Snapshot::from_bytes(&damaged, &snapshot()).is_err(), "byte {position}");
            assert!(Snapshot::from_bytes(&bytes[..position], &snapshot()).is_err(), "{position} bytes");
        }
        assert!(Snapshot::from_bytes(&[&bytes[..], &[0]].concat(), &snapshot()).is_err(), "one byte too many");
    }

    #[test]
    fn the_state_of_another_surrogate_is_called_foreign() {
        let other = Snapshot { surrogate: fingerprint(b"other"), values: vec![0.0], ..snapshot() };
        assert_eq!(Snapshot::from_bytes(&snapshot().to_bytes(), &other), Err(Refusal::ForeignState));
    }
}
