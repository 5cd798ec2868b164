//! Script that submits a sweep to Slurm.

use std::path::Path;

use crate::cli::shell_quoted;

use super::{ArrayJob, RETRIES};

impl ArrayJob<'_> {
    /// Returns a script that submits itself to Slurm as one or more job arrays, none larger than
    /// the cluster allows. `time_limit` is the limit of each job, as `sbatch --time` takes it.
    ///
    /// A member that Slurm stops writes a checkpoint (exit code 3) and is requeued without limit. A
    /// member that fails or is killed, for instance for its memory, is tried again three times; a
    /// file beside Slurm's output lists its failures.
    pub fn slurm_script(&self, program: &Path, time_limit: Option<&str>) -> String {
        let Self { job_count, threads, memory_mib, .. } = self;
        let [program, plan, runs] = [program, self.plan, self.runs].map(quoted);
        let options = self.options().join(" ");
        let requests = self.slurm_requests(time_limit);
        // The limit of an array holds for that array alone, so one begins when another has ended.
        let (throttle, after) = match self.parallel {
            Some(most) => (format!("%{most}"), "${array:+--dependency=afterany:$array} "),
            None => (String::new(), ""),
        };
        // `TERM@120` leaves two minutes to write a checkpoint before Slurm kills the member
        format!(
            r#"#!/usr/bin/env bash
# Submit it with `bash`. Each job of the plan is a member of a job array.
#SBATCH --job-name=covers
#SBATCH --cpus-per-task={threads}
#SBATCH --mem={memory_mib}M
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=TERM@120
{requests}if [ -z "${{SLURM_ARRAY_TASK_ID:-}}" ]; then
  size=$(scontrol show config | awk '$1 == "MaxArraySize" {{ print $3 }}')
  array=
  for ((first = 0; first < {job_count}; first += size)); do
    count=$(({job_count} - first < size ? {job_count} - first : size))
    array=$(sbatch --parsable {after}--array="0-$((count - 1)){throttle}" "$0" "$first") || exit
    # a federation adds its name
    array=${{array%%;*}}
    echo "jobs $first to $((first + count - 1)): array $array"
  done
  exit
fi
job=$(($1 + SLURM_ARRAY_TASK_ID))
srun --cpus-per-task={threads} {program} sweep {plan} --runs {runs} {options} --job "$job"
code=$?
member="${{SLURM_ARRAY_JOB_ID}}_${{SLURM_ARRAY_TASK_ID}}"
failures="slurm-$member.failures"
case $code in
  0) exit 0 ;;
  2) echo "job $job: wrong options, not tried again" >&2; exit 2 ;;
  3) scontrol requeue "$member"; exit 3 ;;
esac
echo "exit code $code" >> "$failures"
count=$(wc -l < "$failures")
if [ "$count" -le {RETRIES} ]; then
  echo "job $job: failed with exit code $code, tried again" >&2
  scontrol requeue "$member"
else
  echo "job $job: failed $count times, given up: see $failures" >&2
fi
exit $code
"#
        )
    }

    /// Returns the lines of the script that request what only some jobs need.
    fn slurm_requests(&self, time_limit: Option<&str>) -> String {
        let gpu = self.needs_gpu().then_some("gpu:1");
        let options = [("time", time_limit), ("gres", gpu)].into_iter();
        let line = |(option, value)| Some(format!("#SBATCH --{option}={}\n", value?));
        options.filter_map(line).collect()
    }
}

fn quoted(path: &Path) -> String {
    shell_quoted(&path.display().to_string())
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;
    use std::process::Command;

    use learner::DeviceChoice;

    use super::super::example;
    use super::*;

    /// Temporary folder in which the script runs, with shell functions in place of Slurm's commands
    /// and of the program, which print their arguments.
    struct Cluster {
        folder: PathBuf,
        script: String,
    }

    impl Cluster {
        fn new(name: &str, job: ArrayJob, time_limit: Option<&str>) -> Self {
            let name = format!("covers-slurm-{name}-{}", std::process::id());
            let folder = std::env::temp_dir().join(name);
            std::fs::create_dir_all(&folder).unwrap();
            let script = job.slurm_script(Path::new("covers"), time_limit);
            Self { folder, script }
        }

        /// Returns standard output and exit code of member 4 of the array that begins with job 20
        /// if the program exits with `code`.
        fn run(&self, code: i32) -> (String, i32) {
            self.bash(&format!(
                "srun() {{ echo \"$1\"; shift; \"$@\"; }}
                covers() {{ printf '%s|' \"$@\"; return {code}; }}
                scontrol() {{ printf '%s|' scontrol \"$@\"; }}
                SLURM_ARRAY_JOB_ID=77 SLURM_ARRAY_TASK_ID=4
                set -- 20\n"
            ))
        }

        /// Returns standard output of the submission to a cluster that takes arrays of four.
        fn submit(&self) -> String {
            let (printed, code) = self.bash(
                "scontrol() { echo 'MaxArraySize            = 4'; }
                sbatch() { echo \"$*\" >&3; echo \"$((++number + 100));cluster\"; }
                exec 3>&1\n",
            );
            assert_eq!(code, 0);
            printed
        }

        fn bash(&self, doubles: &str) -> (String, i32) {
            let output = Command::new("bash")
                .args(["-c", &format!("{doubles}{}", self.script), "script"])
                .current_dir(&self.folder)
                .env_remove("SLURM_ARRAY_TASK_ID")
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
    fn a_member_does_its_job_and_is_put_back_after_a_stop() {
        let cluster = Cluster::new("stop", example(), None);
        for (code, requeued) in [(0, ""), (2, ""), (3, REQUEUED)] {
            let plan = example().plan.display();
            let expected = format!(
                "--cpus-per-task=3\nsweep|{plan}|--runs|/covers/runs|--threads|3|--device|cpu|\
                 --job|24|{requeued}"
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
            let cluster = Cluster::new(&format!("fails-{code}"), example(), None);
            for attempt in 1..=5 {
                let (printed, ended) = cluster.run(code);
                let again = printed.ends_with(REQUEUED);
                assert_eq!((again, ended), (attempt <= RETRIES, code), "{attempt}");
            }
        }
    }

    #[test]
    fn requests_are_those_of_the_options() {
        let cpu = example().slurm_script(Path::new("covers"), None);
        let gpu = ArrayJob { device: DeviceChoice::Gpu, ..example() };
        let gpu = gpu.slurm_script(Path::new("covers"), Some("1-00:30:00"));
        let has = |script: &str, request| {
            script.lines().any(|line| line.strip_prefix("#SBATCH --") == Some(request))
        };
        for request in ["cpus-per-task=3", "mem=1536M", "requeue", "open-mode=append"] {
            assert!(has(&cpu, request) && has(&gpu, request), "{request}: {cpu}");
        }
        for request in ["time=1-00:30:00", "gres=gpu:1"] {
            assert!(!has(&cpu, request) && has(&gpu, request), "{request}: {gpu}");
        }
        assert!(gpu.contains("--device gpu"));
    }

    #[test]
    fn a_plan_is_split_into_arrays_that_the_cluster_takes() {
        assert_eq!(
            Cluster::new("split", example(), None).submit(),
            "--parsable --array=0-3 script 0\njobs 0 to 3: array 101\n\
             --parsable --array=0-3 script 4\njobs 4 to 7: array 101\n\
             --parsable --array=0-0 script 8\njobs 8 to 8: array 101\n"
        );
        let few = ArrayJob { parallel: Some(2), ..example() };
        let printed = Cluster::new("few", few, None).submit();
        let submissions: Vec<&str> =
            printed.lines().filter(|line| line.starts_with("--parsable")).collect();
        assert_eq!(
            submissions,
            [
                "--parsable --array=0-3%2 script 0",
                "--parsable --dependency=afterany:101 --array=0-3%2 script 4",
                "--parsable --dependency=afterany:101 --array=0-0%2 script 8",
            ]
        );
    }
}
