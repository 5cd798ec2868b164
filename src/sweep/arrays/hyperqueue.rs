//! Program that submits a sweep to HyperQueue.

use std::path::Path;

use serde_json::json;

use super::{ArrayJob, RETRIES};

impl ArrayJob<'_> {
    /// Returns a Python program that submits a task for each job of the plan to a HyperQueue
    /// server. It imports the package `hyperqueue`, and takes the server's folder from
    /// `HQ_SERVER_DIR`.
    ///
    /// HyperQueue starts tasks again if their node is lost. A run that fails or is killed is tried
    /// again three times within its task.
    pub fn hyperqueue_python_script(&self, program: &Path) -> String {
        let Self { job_count, threads, memory_mib, .. } = self;
        let [program, plan, runs] =
            [program, self.plan, self.runs].map(|path| path.display().to_string());
        let start = ["sweep".to_owned(), plan, "--runs".to_owned(), runs];
        // a list of strings is written alike in JSON and Python
        let command = json!([vec![program], start.to_vec(), self.options()].concat());
        let gpu = if self.needs_gpu() { r#", "gpus/nvidia": 1"# } else { "" };
        let last = RETRIES + 1;
        format!(
            r#"#!/usr/bin/env python3
"""Submits the jobs of a sweep to the HyperQueue server in HQ_SERVER_DIR."""
import os

from hyperqueue import Client, Job
from hyperqueue.ffi.protocol import ResourceRequest

COMMAND = {command}
RETRY = """
for attempt in {{1..{last}}}; do
  "$@"
  code=$?
  # done, wrong options, or stopped with a checkpoint
  case $code in 0 | 2 | 3) exit $code ;; esac
  echo "attempt $attempt: failed with exit code $code" >&2
done
exit $code
"""

job = Job(name="covers", max_fails=None)
for index in range({job_count}):
    arguments = ["bash", "-c", RETRY, "bash", *COMMAND, "--job", str(index)]
    resources = ResourceRequest(cpus={threads}, resources={{"mem": {memory_mib}{gpu}}})
    job.program(arguments, resources=resources)
submitted = Client(os.environ.get("HQ_SERVER_DIR")).submit(job)
print(f"{job_count} tasks: job {{submitted.id}}")
"#
        )
    }
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use learner::DeviceChoice;

    use super::super::example;
    use super::*;

    fn program(job: ArrayJob) -> String {
        job.hyperqueue_python_script(Path::new("/bin/my covers"))
    }

    #[test]
    fn every_job_is_a_task_with_its_requests() {
        let text = program(example());
        let command = r#"COMMAND = ["/bin/my covers","sweep","/covers/o'neil/my \"plan\" $(HOME).json","--runs","/covers/runs","--threads","3","--device","cpu"]"#;
        assert!(text.lines().any(|line| line == command), "{text}");
        assert!(text.contains("for index in range(9):"), "{text}");
        assert!(text.contains(r#"cpus=3, resources={"mem": 1536})"#), "{text}");
        let gpu = program(ArrayJob { device: DeviceChoice::Gpu, ..example() });
        assert!(gpu.contains(r#"resources={"mem": 1536, "gpus/nvidia": 1})"#), "{gpu}");
    }

    #[test]
    fn a_run_that_fails_is_tried_again_and_one_that_stopped_is_not() {
        let text = program(example());
        let retry = text.split("\"\"\"\n").nth(2).unwrap();
        for (code, attempts) in [(0, 1), (1, 4), (2, 1), (3, 1), (137, 4)] {
            let output = Command::new("bash")
                .args(["-c", retry, "bash", "bash", "-c", &format!("echo run; exit {code}")])
                .output()
                .unwrap();
            assert_eq!(output.status.code(), Some(code));
            assert_eq!(output.stdout, "run\n".repeat(attempts).as_bytes(), "{code}");
        }
    }
}
