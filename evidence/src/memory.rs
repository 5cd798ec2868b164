//! What is remembered of one policy.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::account::Account;
use crate::opinion::mean_earned;

/// What a policy is known by: the accounts of the latest episodes on which it learnt.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Memory {
    pub(crate) accounts: VecDeque<Account>,
    /// Mean earnings of the first rollout on which it learnt.
    pub(crate) beginning: Option<f64>,
}

impl Memory {
    /// The share of what was learnt to earn that `accounts` did not pay, at most 1 for those that
    /// pay what the first rollout paid.
    pub(crate) fn lost(&self, accounts: &[&Account]) -> f64 {
        let now = mean_earned(accounts.iter().copied());
        let home = mean_earned(self.accounts.iter());
        match (self.beginning, home, now) {
            (Some(beginning), Some(home), Some(now)) if home > beginning => {
                (home - now) / (home - beginning)
            }
            _ => 0.0,
        }
    }
}
