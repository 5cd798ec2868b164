//! Fuzz target of plans of sweeps.

use std::path::{Component, Path};

use allocation_counter::opt_out;
use covers::sweep::SweepPlan;

use super::{Reading, Target, accepted, measured, texts};

pub const PLAN: Target = Target::new("plan", read, plans).holding(64, 1 << 12).tried(2_000);

/// Largest number of jobs that are listed: a large list is a choice of the user, not a failure.
const JOBS: usize = 2;

fn read(input: &[u8]) -> Option<Reading> {
    let text = str::from_utf8(input).ok()?;
    measured(|| {
        let plan = SweepPlan::parse(text);
        if let Ok(plan) = &plan {
            opt_out(|| list(plan));
        }
        accepted(plan)
    })
}

/// Asserts that a plan survives a round trip through text, and that the folders of its jobs lie in
/// the requested folder.
fn list(plan: &SweepPlan) {
    let text = serde_json::to_string(plan).unwrap_or_default();
    assert_eq!(SweepPlan::parse(&text).ok().as_ref(), Some(plan), "{text}");
    if plan.methods.len() * plan.seeds.len() > JOBS {
        return;
    }
    let jobs = plan.jobs_unchecked();
    for job in jobs.iter().flatten() {
        let parts: Vec<Component> = Path::new(&job.folder_name).components().collect();
        assert!(matches!(parts[..], [Component::Normal(_)]), "{:?}", job.folder_name);
    }
    accepted(jobs);
}

fn plans() -> Vec<Vec<u8>> {
    texts([
        r#"{"methods": ["covers"], "seeds": [7], "budget": "smoke"}"#,
        r#"{"methods": ["3rl"], "seeds": [0], "budget": "zero-shot",
            "set": ["envs.embodiment=hand", "schedule.cycles=1", "checkpoints.every=2"]}"#,
        r#"{"methods": ["covers", "equi-sac"], "seeds": [18446744073709551615],
            "budget": "full", "set": ["gamma=0.9"]}"#,
        r#"{"methods": ["clear"], "seeds": [1, 1], "budget": "short", "set": []}"#,
        r#"{"methods": [], "seeds": [], "budget": "full", "set": ["covers.seed=3"]}"#,
    ])
}
