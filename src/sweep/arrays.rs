//! The same plan on a cluster: array jobs whose members share nothing but a folder.

use std::path::Path;

/// A Slurm script: one member of the array for each job. A member that is told to stop leaves a
/// checkpoint (exit code 3) and is put into the queue again.
pub fn slurm(program: &Path, plan: &Path, runs: &Path, jobs: usize) -> String {
    let last = jobs.saturating_sub(1);
    let (program, plan, runs) = (quoted(program), quoted(plan), quoted(runs));
    format!(
        r#"#!/usr/bin/env bash
#SBATCH --job-name=covers
#SBATCH --array=0-{last}
#SBATCH --cpus-per-task=1
#SBATCH --mem=4G
#SBATCH --requeue
#SBATCH --signal=TERM@120
srun {program} sweep {plan} --runs {runs} --job "$SLURM_ARRAY_TASK_ID"
code=$?
if [ $code -eq 3 ]; then
  scontrol requeue "${{SLURM_ARRAY_JOB_ID}}_${{SLURM_ARRAY_TASK_ID}}"
fi
exit $code
"#
    )
}

/// A Kubernetes job: one index for each job, in containers of `image`, whose entry point is the
/// `covers` program. The plan and the runs lie on the volume of the claim `covers`. A pod that is
/// stopped leaves a checkpoint (exit code 3), which counts as no failure.
pub fn kubernetes(image: &str, plan: &Path, runs: &Path, jobs: usize) -> String {
    let (plan, runs) = (plan.display(), runs.display());
    format!(
        r#"apiVersion: batch/v1
kind: Job
metadata:
  name: covers
spec:
  completionMode: Indexed
  completions: {jobs}
  parallelism: {jobs}
  backoffLimitPerIndex: 3
  podFailurePolicy:
    rules:
      - action: Ignore
        onExitCodes: {{containerName: covers, operator: In, values: [3]}}
      - action: Ignore
        onPodConditions: [{{type: DisruptionTarget}}]
  template:
    spec:
      restartPolicy: Never
      terminationGracePeriodSeconds: 120
      containers:
        - name: covers
          image: "{image}"
          args: [sweep, "{plan}", --runs, "{runs}", --job, "$(JOB_COMPLETION_INDEX)"]
          resources: {{requests: {{cpu: "1", memory: 4Gi}}}}
          volumeMounts: [{{name: covers, mountPath: /covers}}]
      volumes:
        - name: covers
          persistentVolumeClaim: {{claimName: covers}}
"#
    )
}

/// A path as a shell reads it back.
fn quoted(path: &Path) -> String {
    format!("'{}'", path.display().to_string().replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shell_reads_paths_back() {
        let path = Path::new("/home/o'neil/my plans/a$b.json");
        let script = format!("printf %s {}", quoted(path));
        let said = std::process::Command::new("sh")
            .args(["-c", &script])
            .output();
        assert_eq!(
            said.unwrap().stdout,
            path.display().to_string().into_bytes()
        );
    }

    #[test]
    fn scripts_have_a_member_for_each_job_and_are_valid() {
        let (plan, runs) = (Path::new("/covers/plan.json"), Path::new("/covers/runs"));
        let script = slurm(Path::new("/usr/bin/covers"), plan, runs, 9);
        assert!(script.contains("--array=0-8"), "{script}");
        let checked = std::process::Command::new("bash")
            .args(["-n", "-c", &script])
            .output();
        assert!(checked.unwrap().status.success(), "{script}");
        let yaml = kubernetes("covers:0.1.0", plan, runs, 9);
        assert!(
            yaml.contains("completions: 9") && !yaml.contains("{{"),
            "{yaml}"
        );
    }
}
