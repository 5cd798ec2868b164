//! Manifest of a sweep for Kubernetes.

use std::path::{Component, Path};

use serde_json::{Value, json};

use experiments::RunError;

use super::{ArrayJob, RETRIES};

/// Path at which the containers of a Kubernetes job mount the volume.
const MOUNT: &str = "/covers";
/// Number of jobs that run at a time where [`ArrayJob::parallel`] does not say it: a plan must not
/// fill a shared cluster.
const PARALLEL: usize = 32;
/// User and group of the processes, which also own the volume's files.
const USER: u32 = 1000;
/// Largest length of names. With the index of a pod and a random suffix, a label has at most 63.
const MAX_NAME: usize = 50;

/// Options of a Kubernetes job that other array jobs do not have.
#[derive(Clone, Copy, Debug)]
pub struct KubernetesOptions<'a> {
    /// Image of the containers, whose entry point is the `covers` program.
    pub image: &'a str,
    /// Name of the job, unique in its namespace.
    pub name: &'a str,
    /// Name of the claim of the volume with the plan and the runs.
    pub claim: &'a str,
    /// Size of a new claim, such as `100Gi`; `None` if the claim exists.
    pub claim_size: Option<&'a str>,
}

impl ArrayJob<'_> {
    /// Returns a Kubernetes job as JSON, which `kubectl apply` accepts like YAML, with the claim of
    /// its volume if that is to be created. Needs Kubernetes 1.29 or later, and meets the
    /// restricted Pod Security Standard. The volume is mounted at `/covers`. A stopped pod writes a
    /// checkpoint (exit code 3), which does not count as a failure.
    ///
    /// # Errors
    /// [`RunError::InvalidSetting`] for a plan or runs outside the volume, and for names that
    /// Kubernetes does not take.
    pub fn kubernetes_json(&self, options: KubernetesOptions) -> Result<Value, RunError> {
        let job = self.kubernetes_job(options)?;
        let Some(size) = options.claim_size else {
            return Ok(job);
        };
        let claim = json!({
            "apiVersion": "v1",
            "kind": "PersistentVolumeClaim",
            "metadata": {"name": options.claim},
            "spec": {
                "accessModes": ["ReadWriteMany"],
                "resources": {"requests": {"storage": size}},
            },
        });
        Ok(json!({"apiVersion": "v1", "kind": "List", "items": [claim, job]}))
    }

    fn kubernetes_job(&self, options: KubernetesOptions) -> Result<Value, RunError> {
        let KubernetesOptions { image, name, claim, .. } = options;
        check_name("name", name)?;
        check_name("claim", claim)?;
        let plan = on_the_volume("plan", self.plan)?;
        let runs = on_the_volume("runs", self.runs)?;
        let start = ["sweep".to_owned(), plan, "--runs".to_owned(), runs];
        let job = ["--job", "$(JOB_COMPLETION_INDEX)"].map(str::to_owned);
        let arguments = [&start[..], &self.options(), &job].concat();
        let container = self.container(image, &arguments);
        // pods that were stopped or evicted are replaced without counting as failures
        let stops = json!([
            {"action": "Ignore",
                "onExitCodes": {"containerName": "covers", "operator": "In", "values": [3]}},
            {"action": "Ignore",
                "onPodConditions": [{"type": "DisruptionTarget", "status": "True"}]},
        ]);
        let labels = json!({"app.kubernetes.io/name": "covers"});
        Ok(json!({
            "apiVersion": "batch/v1",
            "kind": "Job",
            "metadata": {"name": name, "labels": labels},
            "spec": {
                "completionMode": "Indexed",
                "completions": self.job_count,
                "parallelism": self.parallel.unwrap_or(PARALLEL).min(self.job_count),
                "backoffLimitPerIndex": RETRIES,
                "podFailurePolicy": {"rules": stops},
                "template": {"metadata": {"labels": labels}, "spec": {
                    "restartPolicy": "Never",
                    "terminationGracePeriodSeconds": 120,
                    "securityContext": {
                        "runAsNonRoot": true,
                        "runAsUser": USER,
                        "runAsGroup": USER,
                        "fsGroup": USER,
                        "fsGroupChangePolicy": "OnRootMismatch",
                        "seccompProfile": {"type": "RuntimeDefault"},
                    },
                    "containers": [container],
                    "volumes": [{"name": "covers", "persistentVolumeClaim": {"claimName": claim}}],
                }},
            },
        }))
    }

    /// Returns the container of a job, with the rights that the restricted pod security standard
    /// allows.
    fn container(&self, image: &str, arguments: &[String]) -> Value {
        let memory = format!("{}Mi", self.memory_mib);
        let mut limits = json!({"memory": memory});
        if self.needs_gpu() {
            limits["nvidia.com/gpu"] = json!(1);
        }
        json!({
            "name": "covers",
            "image": image,
            "args": arguments,
            "resources": {
                "requests": {"cpu": self.threads.to_string(), "memory": memory},
                "limits": limits,
            },
            "securityContext": {
                "allowPrivilegeEscalation": false,
                "capabilities": {"drop": ["ALL"]},
            },
            "volumeMounts": [{"name": "covers", "mountPath": MOUNT}],
        })
    }
}

/// Rejects names that Kubernetes does not take.
fn check_name(option: &'static str, name: &str) -> Result<(), RunError> {
    let plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-';
    let is_name = (1..=MAX_NAME).contains(&name.len())
        && name.bytes().all(plain)
        && !name.starts_with('-')
        && !name.ends_with('-');
    if is_name {
        return Ok(());
    }
    Err(RunError::invalid(
        option,
        name,
        "1 to 50 lower-case letters, digits and hyphens, with no hyphen at an end",
    ))
}

/// Returns a path on the volume, escaped as an argument of a container.
fn on_the_volume(name: &'static str, path: &Path) -> Result<String, RunError> {
    let climbs = path.components().any(|part| part == Component::ParentDir);
    match path.to_str() {
        // Kubernetes replaces `$(NAME)` in arguments, and reads `$$` as one `$`
        Some(text) if path.starts_with(MOUNT) && !climbs => Ok(text.replace('$', "$$")),
        _ => Err(RunError::invalid(
            name,
            path.display(),
            "an absolute path inside /covers, where containers see the volume",
        )),
    }
}

#[cfg(test)]
mod tests {
    use learner::DeviceChoice;

    use super::super::example;
    use super::*;

    const OPTIONS: KubernetesOptions = KubernetesOptions {
        image: "registry:5000/a \"b\":{{c}}",
        name: "my-sweep",
        claim: "disk",
        claim_size: None,
    };

    #[test]
    fn a_job_has_an_index_for_each_run_and_says_what_to_run() {
        let job = example().kubernetes_json(OPTIONS).unwrap();
        let read: Value = serde_json::from_str(&format!("{job:#}")).unwrap();
        assert_eq!(read["metadata"]["name"], "my-sweep");
        assert_eq!(read["spec"]["completions"], 9);
        let pod = &read["spec"]["template"]["spec"];
        assert_eq!(pod["volumes"][0]["persistentVolumeClaim"]["claimName"], "disk");
        let container = &pod["containers"][0];
        assert_eq!(container["image"], OPTIONS.image);
        assert_eq!(container["resources"]["requests"]["cpu"], "3");
        assert_eq!(container["resources"]["limits"], json!({"memory": "1536Mi"}));
        let plan = "/covers/o'neil/my \"plan\" $$(HOME).json";
        let expected = json!([
            "sweep",
            plan,
            "--runs",
            "/covers/runs",
            "--threads",
            "3",
            "--device",
            "cpu",
            "--job",
            "$(JOB_COMPLETION_INDEX)",
        ]);
        assert_eq!(container["args"], expected);
        let gpu = ArrayJob { device: DeviceChoice::Gpu, ..example() };
        let gpu = gpu.kubernetes_json(OPTIONS).unwrap();
        let limits = &gpu["spec"]["template"]["spec"]["containers"][0]["resources"]["limits"];
        assert_eq!(limits["nvidia.com/gpu"], 1);
    }

    /// The controls of <https://kubernetes.io/docs/concepts/security/pod-security-standards/> that
    /// a pod must set by itself.
    #[test]
    fn pods_meet_the_restricted_standard() {
        let job = example().kubernetes_json(OPTIONS).unwrap();
        let pod = &job["spec"]["template"]["spec"];
        let context = &pod["securityContext"];
        assert_eq!(context["runAsNonRoot"], true);
        assert_eq!(context["seccompProfile"]["type"], "RuntimeDefault");
        let container = &pod["containers"][0]["securityContext"];
        assert_eq!(container["allowPrivilegeEscalation"], false);
        assert_eq!(container["capabilities"], json!({"drop": ["ALL"]}));
    }

    #[test]
    fn the_number_of_pods_at_a_time_is_limited() {
        let pods = |job_count, parallel| {
            let job = ArrayJob { job_count, parallel, ..example() };
            job.kubernetes_json(OPTIONS).unwrap()["spec"]["parallelism"].clone()
        };
        assert_eq!(pods(9, None), 9);
        assert_eq!(pods(1000, None), 32);
        assert_eq!(pods(1000, Some(500)), 500);
    }

    #[test]
    fn a_claim_that_is_to_be_created_can_be_shared() {
        let options = KubernetesOptions { claim_size: Some("100Gi"), ..OPTIONS };
        let list = example().kubernetes_json(options).unwrap();
        let [claim, job] = &list["items"].as_array().unwrap()[..] else { panic!("{list}") };
        assert_eq!(*job, example().kubernetes_json(OPTIONS).unwrap());
        assert_eq!(claim["metadata"]["name"], "disk");
        assert_eq!(claim["spec"]["accessModes"], json!(["ReadWriteMany"]));
        assert_eq!(claim["spec"]["resources"]["requests"]["storage"], "100Gi");
    }

    #[test]
    fn names_and_paths_that_kubernetes_does_not_take_are_refused() {
        for path in ["plan.json", "/elsewhere/plan.json", "/covers/../x", "/coversx/x"] {
            let path = Path::new(path);
            let (mut plan, mut runs) = (example(), example());
            (plan.plan, runs.runs) = (path, path);
            for (array, name) in [(plan, "plan"), (runs, "runs")] {
                let message = array.kubernetes_json(OPTIONS).unwrap_err().to_string();
                let expected = format!("`{name}` is {}, expected", path.display());
                assert!(message.contains(&expected), "{message}");
                assert!(message.contains("inside /covers"), "{message}");
            }
        }
        for name in ["", "Covers", "-a", "a-", "a.b", &"a".repeat(51)] {
            for options in [
                KubernetesOptions { name, ..OPTIONS },
                KubernetesOptions { claim: name, ..OPTIONS },
            ] {
                assert!(example().kubernetes_json(options).is_err(), "{name}");
            }
        }
    }
}
