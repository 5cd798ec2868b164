//! Sweeps on a cluster: array jobs whose members share nothing but a folder.

use std::path::{Component, Path};

use serde_json::{Value, json};

use experiments::RunError;

/// Number of times that a failed job is tried again.
const RETRIES: usize = 3;

/// Path at which the containers of a Kubernetes job mount the volume.
const MOUNT: &str = "/covers";

/// Sweep plan as an array job, each member of which runs `covers sweep` for one job of the plan.
#[derive(Clone, Copy, Debug)]
pub struct ArrayJob<'a> {
    /// Path of the plan's file for the members.
    pub plan: &'a Path,
    /// Path of the folder of runs for the members.
    pub runs: &'a Path,
    /// Number of jobs of the sweep plan.
    pub job_count: usize,
    /// Worker threads of each run; as many CPUs are requested.
    pub threads: usize,
}

impl ArrayJob<'_> {
    /// Returns a Slurm script. A member that Slurm stops writes a checkpoint (exit code 3) and is
    /// requeued without limit. A member that fails or is killed, for instance for its memory, is
    /// tried again three times; a file beside Slurm's output lists its failures.
    pub fn slurm_script(&self, program: &Path) -> String {
        let (last, threads) = (self.job_count.saturating_sub(1), self.threads);
        // `TERM@120` leaves two minutes to write a checkpoint before Slurm kills the member
        let [program, plan, runs] = [program, self.plan, self.runs].map(quoted);
        format!(
            r#"#!/usr/bin/env bash
#SBATCH --job-name=covers
#SBATCH --array=0-{last}
#SBATCH --cpus-per-task={threads}
#SBATCH --mem=4G
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=TERM@120
srun --cpus-per-task={threads} {program} sweep {plan} --runs {runs} --threads {threads} \
  --job "$SLURM_ARRAY_TASK_ID"
code=$?
member="${{SLURM_ARRAY_JOB_ID}}_${{SLURM_ARRAY_TASK_ID}}"
failures="slurm-$member.failures"
case $code in
  0) exit 0 ;;
  2) echo "job $SLURM_ARRAY_TASK_ID: wrong options, not tried again" >&2; exit 2 ;;
  3) scontrol requeue "$member"; exit 3 ;;
esac
echo "exit code $code" >> "$failures"
count=$(wc -l < "$failures")
if [ "$count" -le {RETRIES} ]; then
  echo "job $SLURM_ARRAY_TASK_ID: failed with exit code $code, tried again" >&2
  scontrol requeue "$member"
else
  echo "job $SLURM_ARRAY_TASK_ID: failed $count times, given up: see $failures" >&2
fi
exit $code
"#
        )
    }

    /// Returns a Kubernetes job as JSON, which `kubectl apply` accepts like YAML. Its containers
    /// run `image`, whose entry point is the `covers` program. The plan and the runs are on the
    /// volume of the claim `covers`, mounted at `/covers`. A stopped pod writes a checkpoint (exit
    /// code 3), which does not count as a failure.
    ///
    /// # Errors
    /// [`RunError::InvalidSetting`] for a plan or runs outside the volume.
    pub fn kubernetes_job_json(&self, image: &str) -> Result<Value, RunError> {
        let plan = on_the_volume("plan", self.plan)?;
        let runs = on_the_volume("runs", self.runs)?;
        let threads = self.threads.to_string();
        let container = json!({
            "name": "covers",
            "image": image,
            "args": ["sweep", plan, "--runs", runs, "--threads", threads,
                "--job", "$(JOB_COMPLETION_INDEX)"],
            "resources": {"requests": {"cpu": threads, "memory": "4Gi"}},
            "volumeMounts": [{"name": "covers", "mountPath": MOUNT}],
        });
        // pods that were stopped or evicted are replaced without counting as failures
        let stops = json!([
            {"action": "Ignore",
                "onExitCodes": {"containerName": "covers", "operator": "In", "values": [3]}},
            {"action": "Ignore",
                "onPodConditions": [{"type": "DisruptionTarget", "status": "True"}]},
        ]);
        Ok(json!({
            "apiVersion": "batch/v1",
            "kind": "Job",
            "metadata": {"name": "covers"},
            "spec": {
                "completionMode": "Indexed",
                "completions": self.job_count,
                "parallelism": self.job_count,
                "backoffLimitPerIndex": RETRIES,
                "podFailurePolicy": {"rules": stops},
                "template": {"spec": {
                    "restartPolicy": "Never",
                    "terminationGracePeriodSeconds": 120,
                    "containers": [container],
                    "volumes": [{"name": "covers", "persistentVolumeClaim": {"claimName": "covers"}}],
                }},
            },
        }))
    }
}

/// Returns a path on the volume, escaped as an argument of a container.
fn on_the_volume(name: &'static str, path: &Path) -> Result<String, RunError> {
    let climbs = path.components().any(|part| part == Component::ParentDir);
    match path.to_str() {
        // Kubernetes replaces `$(NAME)` in arguments, and reads `$$` as one `$`
        Some(text) if path.starts_with(MOUNT) && !climbs => Ok(text.replace('$', "$$")),
        _ => Err(RunError::InvalidSetting {
            name,
            value: path.display().to_string(),
            expected: "an absolute path inside /covers, where containers see the volume",
        }),
    }
}

/// Quotes a path for a shell.
fn quoted(path: &Path) -> String {
    format!("'{}'", path.display().to_string().replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;
    use std::process::Command;

    use super::*;

    fn array() -> ArrayJob<'static> {
        ArrayJob {
            plan: Path::new("/covers/o'neil/my \"plan\" $(HOME).json"),
            runs: Path::new("/covers/runs"),
            job_count: 9,
            threads: 3,
        }
    }

    /// Temporary folder in which the script runs, with shell functions in place of Slurm's commands
    /// and of the program, which print their arguments.
    struct Cluster {
        folder: PathBuf,
        script: String,
    }

    impl Cluster {
        fn new(name: &str) -> Self {
            let name = format!("covers-slurm-{name}-{}", std::process::id());
            let folder = std::env::temp_dir().join(name);
            std::fs::create_dir_all(&folder).unwrap();
            let script = array().slurm_script(Path::new("covers"));
            Self { folder, script }
        }

        /// Returns standard output and exit code of the script if the program exits with `code`.
        fn run(&self, code: i32) -> (String, i32) {
            let doubles = format!(
                "srun() {{ echo \"$1\"; shift; \"$@\"; }}
                covers() {{ printf '%s|' \"$@\"; return {code}; }}
                scontrol() {{ printf '%s|' scontrol \"$@\"; }}
                SLURM_ARRAY_JOB_ID=77 SLURM_ARRAY_TASK_ID=4\n"
            );
            let output = Command::new("bash")
                .args(["-c", &(doubles + &self.script)])
                .current_dir(&self.folder)
                .output()
                .unwrap();
            let printed = String::from_utf8(output.stdout).unwrap();
            (printed, output.status.code().unwrap())
        }
    }

    impl Drop for Cluster {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.folder);
        }
    }

    const REQUEUED: &str = "scontrol|requeue|77_4|";

    #[test]
    fn a_member_of_the_slurm_array_does_its_job_and_is_put_back_after_a_stop() {
        let cluster = Cluster::new("stop");
        for line in
            ["#SBATCH --array=0-8", "#SBATCH --cpus-per-task=3", "#SBATCH --open-mode=append"]
        {
            let script = &cluster.script;
            assert!(script.lines().any(|said| said == line), "{script}");
        }
        for (code, requeued) in [(0, ""), (2, ""), (3, REQUEUED)] {
            let plan = array().plan.display();
            let expected = format!(
                "--cpus-per-task=3\nsweep|{plan}|--runs|/covers/runs|--threads|3|--job|4|{requeued}"
            );
            // stops are no failures: there is no limit to their number
            for _ in 0..5 {
                assert_eq!(cluster.run(code), (expected.clone(), code));
            }
        }
    }

    #[test]
    fn a_member_that_fails_or_is_killed_is_tried_again_a_few_times() {
        for code in [1, 137, 139] {
            let cluster = Cluster::new(&format!("fails-{code}"));
            for attempt in 1..=5 {
                let (printed, ended) = cluster.run(code);
                let again = printed.ends_with(REQUEUED);
                assert_eq!((again, ended), (attempt <= RETRIES, code), "{attempt}");
            }
        }
    }

    #[test]
    fn a_kubernetes_job_has_an_index_for_each_job_and_says_what_to_run() {
        let image = "registry:5000/a \"b\":{{c}}";
        let job = array().kubernetes_job_json(image).unwrap();
        let read: Value = serde_json::from_str(&format!("{job:#}")).unwrap();
        assert_eq!(read["spec"]["completions"], 9);
        let container = &read["spec"]["template"]["spec"]["containers"][0];
        assert_eq!(container["image"], image);
        assert_eq!(container["resources"]["requests"]["cpu"], "3");
        let plan = "/covers/o'neil/my \"plan\" $$(HOME).json";
        let expected = json!([
            "sweep",
            plan,
            "--runs",
            "/covers/runs",
            "--threads",
            "3",
            "--job",
            "$(JOB_COMPLETION_INDEX)",
        ]);
        assert_eq!(container["args"], expected);
    }

    #[test]
    fn paths_that_containers_do_not_see_are_refused_by_name() {
        for path in ["plan.json", "/elsewhere/plan.json", "/covers/../x", "/coversx/x"] {
            let path = Path::new(path);
            let (mut plan, mut runs) = (array(), array());
            (plan.plan, runs.runs) = (path, path);
            for (array, name) in [(plan, "plan"), (runs, "runs")] {
                let message = array.kubernetes_job_json("covers").unwrap_err().to_string();
                let expected = format!("`{name}` is {}, expected", path.display());
                assert!(message.contains(&expected), "{message}");
                assert!(message.contains("inside /covers"), "{message}");
            }
        }
    }
}
