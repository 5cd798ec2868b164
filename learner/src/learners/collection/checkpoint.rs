//! The learner as one file: everything that its next rollout depends on, and a note of the
//! caller's.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use cluster::Reservoir;
use rl::{AlgorithmState, EnvSpec, Observations};
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::error::LearnerError;
use crate::groupings::{Grouping, TaskLabel};
use crate::learners::learner::CheckpointExtent;
use crate::learners::tensor_file::{CheckpointTensor, TensorFile, encode_tensor_file};
use crate::overrides::check_same_settings;

use super::episodes::FirstFrames;
use super::settings::{PolicyCollectionSettings, PolicyTrainer};
use super::{Generators, PolicyCollection, PolicyEntry};

/// Name of the checkpoint array that holds the caller's note.
// Not in the header: that of a safetensors file has at most 100 MB, and a note grows with its run.
const NOTE: &str = "note";

/// Name of the checkpoint array of a policy's parameters from before its latest update.
const PREVIOUS: &str = "previous_params";

fn note_tensor(note: &str) -> CheckpointTensor {
    let bytes = note.as_bytes().to_vec();
    CheckpointTensor::from_bytes(NOTE.to_owned(), vec![bytes.len()], bytes)
}

/// Reads the note, a text that the caller stored with the learner, from the checkpoint at `path`.
///
/// # Errors
/// [`LearnerError::Read`], [`LearnerError::NewerFormat`].
pub fn read_checkpoint_note(path: &Path) -> Result<String, LearnerError> {
    let bytes = std::fs::read(path).map_err(|error| LearnerError::cannot_read(path, error))?;
    let (_, file) = TensorFile::open::<IgnoredAny>(path, &bytes)?;
    file.read_text(NOTE)
}

/// Part of a checkpoint that is stored as JSON: everything that is not an array.
#[derive(Serialize, Deserialize)]
#[serde(
    deny_unknown_fields,
    bound(serialize = "S: Clone + Serialize", deserialize = "S: Clone + DeserializeOwned")
)]
struct Header<'a, S: Clone> {
    settings: Cow<'a, S>,
    grouping: Value,
    current: usize,
    generators: Cow<'a, Generators>,
    members: Vec<EntryHeader>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct EntryHeader {
    /// Counters of the training algorithm by name; `None` if its state was left out.
    counters: Option<BTreeMap<String, u64>>,
    /// Number of episodes whose first frames were offered to the policy's buffer so far.
    seen: u64,
}

impl<S: PolicyCollectionSettings> PolicyCollection<S> {
    /// Returns the bytes of a checkpoint file that holds the learner and the caller's text `note`.
    pub(super) fn to_bytes(
        &self,
        path: &Path,
        extent: CheckpointExtent,
        note: &str,
    ) -> Result<Vec<u8>, LearnerError> {
        let header = Header {
            settings: Cow::Borrowed(&self.settings),
            grouping: self.grouping.state(),
            current: self.current,
            generators: Cow::Borrowed(&self.generators),
            members: self.policies.iter().map(|p| p.header(extent)).collect(),
        };
        self.check_extent(extent)?;
        let entries = self.policies.iter().enumerate();
        let mut tensors: Vec<CheckpointTensor> =
            entries.flat_map(|(index, entry)| entry.tensors(index, &self.spec, extent)).collect();
        tensors.push(note_tensor(note));
        encode_tensor_file(path, &header, &tensors)
    }

    /// Rejects a checkpoint with first frames of too few episodes to recognise task groups.
    fn check_extent(&self, extent: CheckpointExtent) -> Result<(), LearnerError> {
        let least = self.grouping.requirements().episodes;
        match extent {
            CheckpointExtent::Policies { episodes_per_policy: episodes } if episodes < least => {
                let value = format!("{episodes} (the grouping compares {least})");
                let expected = "at least as many as the grouping compares";
                Err(LearnerError::invalid("episodes", value, expected))
            }
            CheckpointExtent::Policies { .. } | CheckpointExtent::Everything => Ok(()),
        }
    }

    /// Reads a learner and the caller's note from a checkpoint that
    /// [`Learner::save`](crate::Learner::save) wrote. `spec` must match its environments; the
    /// grouping is the one that the settings name.
    ///
    /// # Errors
    /// [`LearnerError::Read`] for a file that is missing, damaged, or belongs to other
    /// environments; a grouping that needs labels, or one that does not take the saved state of
    /// another.
    pub fn load(path: &Path, spec: &EnvSpec) -> Result<(Self, String), LearnerError> {
        let grouping = |settings: &S| settings.common().grouping.build_grouping();
        Checkpoint::read(path)?.open(None, spec, true, grouping)
    }

    /// Reads a learner and the caller's note from a checkpoint that
    /// [`Learner::save`](crate::Learner::save) wrote, with `grouping` in place of the one that the
    /// settings name.
    ///
    /// # Errors
    /// Errors of [`PolicyCollection::load`].
    pub fn load_with_grouping(
        path: &Path,
        spec: &EnvSpec,
        grouping: Box<dyn Grouping>,
    ) -> Result<(Self, String), LearnerError> {
        Checkpoint::read(path)?.open(None, spec, true, |_| Ok(grouping))
    }

    /// Reads a checkpoint's learner, which has these settings, for a run that writes `labels`. With
    /// `whole`, further training gives the same bits, and a file of [`CheckpointExtent::Policies`]
    /// is rejected; without, the learner can act and recognise groups, and its training state is
    /// fresh.
    pub(in crate::learners) fn read_with_labels(
        path: &Path,
        spec: &EnvSpec,
        settings: &S,
        labels: &TaskLabel,
        whole: bool,
    ) -> Result<(Self, String), LearnerError> {
        let checkpoint = Checkpoint::read(path)?;
        let header: Header<'static, S> = checkpoint.header()?;
        check_same_settings(path, settings, &*header.settings)?;
        if whole && header.members.iter().any(|m| m.counters.is_none()) {
            let path = path.to_owned();
            return Err(LearnerError::PoliciesOnlyCheckpoint { path });
        }
        let grouping = |chosen: &S| chosen.common().grouping.build_with(labels);
        checkpoint.open(Some(settings), spec, whole, grouping)
    }
}

/// Bytes of a checkpoint and their path, for error messages.
struct Checkpoint<'a> {
    path: &'a Path,
    bytes: Vec<u8>,
}

impl<'a> Checkpoint<'a> {
    fn read(path: &'a Path) -> Result<Self, LearnerError> {
        let bytes = std::fs::read(path).map_err(|error| LearnerError::cannot_read(path, error))?;
        Ok(Self { path, bytes })
    }

    fn header<S: Clone + DeserializeOwned>(&self) -> Result<Header<'static, S>, LearnerError> {
        Ok(TensorFile::open(self.path, &self.bytes)?.0)
    }

    /// Creates the learner and returns it with the note. If `training` is set and the file has it,
    /// the state of the training is restored. `settings` must equal those of the file, and also
    /// hold the fields that are not stored. An error names the file.
    fn open<S: PolicyCollectionSettings>(
        self,
        settings: Option<&S>,
        spec: &EnvSpec,
        training: bool,
        grouping: impl FnOnce(&S) -> Result<Box<dyn Grouping>, LearnerError>,
    ) -> Result<(PolicyCollection<S>, String), LearnerError> {
        let (mut header, file): (Header<'static, S>, _) = TensorFile::open(self.path, &self.bytes)?;
        if let Some(settings) = settings {
            header.settings = Cow::Owned(settings.clone());
        }
        let mut grouping =
            grouping(&header.settings).map_err(|error| error.with_path(self.path))?;
        // the settings determine the sizes of arrays, so they are checked first
        let common = header.settings.common();
        common
            .steps_per_env(spec, grouping.requirements().episodes)
            .map_err(|error| error.with_path(self.path))?;
        let state = grouping.restore(&header.grouping, header.members.len());
        state.map_err(|problem| {
            file.damaged_error(format!("the state of the grouping: {problem}"))
        })?;
        if !training {
            header.members.iter_mut().for_each(|m| m.counters = None);
        }
        let note = file.read_text(NOTE)?;
        let arrays = Arrays { file, spec, settings: &*header.settings };
        let policies = arrays.policies(&header).map_err(|error| error.with_path(self.path))?;
        let mut collection =
            PolicyCollection::with_grouping(header.settings.into_owned(), spec, grouping)
                .map_err(|error| error.with_path(self.path))?;
        collection.policies = policies;
        collection.current = header.current;
        collection.generators = header.generators.into_owned();
        Ok((collection, note))
    }
}

impl<S: PolicyCollectionSettings> PolicyEntry<S> {
    fn header(&self, extent: CheckpointExtent) -> EntryHeader {
        match extent {
            CheckpointExtent::Everything => {
                let counters = self.training.algorithm_state().counters.into_iter();
                let counters = counters.map(|(name, count)| (name.to_owned(), count)).collect();
                EntryHeader { counters: Some(counters), seen: self.buffer.num_offered() }
            }
            CheckpointExtent::Policies { .. } => {
                EntryHeader { counters: None, seen: self.kept(extent).len() as u64 }
            }
        }
    }

    /// Returns the first frames of the episodes that a checkpoint of this extent holds.
    fn kept(&self, extent: CheckpointExtent) -> &[FirstFrames] {
        let all = self.buffer.episodes();
        match extent {
            CheckpointExtent::Everything => all,
            CheckpointExtent::Policies { episodes_per_policy: episodes } => {
                &all[..episodes.min(all.len())]
            }
        }
    }

    fn tensors(
        &self,
        index: usize,
        spec: &EnvSpec,
        extent: CheckpointExtent,
    ) -> Vec<CheckpointTensor> {
        let name = |what: &str| format!("policy.{index}.{what}");
        let flat = |what: &str, values: &[f32]| {
            CheckpointTensor::from_floats(name(what), vec![values.len()], values)
        };
        let mut tensors = vec![flat("params", S::params(&self.policy))];
        if extent == CheckpointExtent::Everything {
            tensors.extend(self.previous.iter().map(|before| flat(PREVIOUS, S::params(before))));
            let state = self.training.algorithm_state().tensors.into_iter();
            tensors.extend(state.map(|(array, values)| flat(array, values)));
            tensors.extend(self.training.extra_tensors(&name("")));
        }
        let episodes = self.kept(extent);
        let frames = episodes.first().map_or(0, FirstFrames::count);
        let shape = |sizes: &[usize]| [&[episodes.len(), frames], sizes].concat();
        let observations = episodes.iter().map(FirstFrames::observations);
        let images = observations.clone().flat_map(|o| o.images.iter().copied());
        let images = images.collect();
        tensors.push(CheckpointTensor::from_bytes(
            name("images"),
            shape(&spec.image_shape),
            images,
        ));
        let vectors: Vec<f32> = observations.flat_map(|o| o.vectors.clone()).collect();
        let vector = shape(&[spec.vector_irreps.len()]);
        tensors.push(CheckpointTensor::from_floats(name("vectors"), vector, &vectors));
        tensors
    }
}

/// Arrays of an open checkpoint file, and the environments and settings that their shapes must fit.
struct Arrays<'a, S> {
    file: TensorFile<'a>,
    spec: &'a EnvSpec,
    settings: &'a S,
}

impl<S: PolicyCollectionSettings> Arrays<'_, S> {
    fn policies(&self, header: &Header<'_, S>) -> Result<Vec<PolicyEntry<S>>, LearnerError> {
        let entries = header.members.iter().enumerate();
        let policies: Vec<_> =
            entries.map(|(index, entry)| self.policy(index, entry)).collect::<Result<_, _>>()?;
        if header.current < policies.len() {
            return Ok(policies);
        }
        let problem = format!("policy {} of {}", header.current, policies.len());
        Err(self.file.damaged_error(problem))
    }

    fn policy(&self, index: usize, header: &EntryHeader) -> Result<PolicyEntry<S>, LearnerError> {
        let name = |what: &str| format!("policy.{index}.{what}");
        let (_, params) = self.file.read_floats(&name("params"))?;
        let policy = self.settings.policy_with_params(self.spec, params)?;
        let mut training = self.settings.new_training(self.spec, &policy)?;
        if let Some(counters) = &header.counters {
            self.restore_training(&name, counters, &mut training)?;
        }
        // a policy that was never updated has no earlier parameters
        let previous = if header.counters.is_some() && self.file.contains(&name(PREVIOUS)) {
            let (_, earlier) = self.file.read_floats(&name(PREVIOUS))?;
            Some(self.settings.policy_with_params(self.spec, earlier)?)
        } else {
            None
        };
        let episodes = self.episodes(&name("images"), &name("vectors"))?;
        let capacity = self.settings.common().buffer_capacity();
        let buffer = Reservoir::from_parts(capacity, header.seen, episodes)?;
        Ok(PolicyEntry { policy, training, previous, buffer })
    }

    fn restore_training(
        &self,
        name: &impl Fn(&str) -> String,
        counters: &BTreeMap<String, u64>,
        training: &mut S::Trainer,
    ) -> Result<(), LearnerError> {
        let fresh = training.algorithm_state().tensors.into_iter();
        let arrays =
            fresh.map(|(own, _)| Ok((own.to_owned(), self.file.read_floats(&name(own))?.1)));
        let arrays: Vec<(String, Vec<f32>)> = arrays.collect::<Result<_, LearnerError>>()?;
        let state = AlgorithmState {
            tensors: arrays.iter().map(|(array, a)| (array.as_str(), a.as_slice())).collect(),
            counters: counters.iter().map(|(counter, n)| (counter.as_str(), *n)).collect(),
        };
        let restored = training.restore_algorithm(&state);
        restored
            .map_err(|error| self.file.damaged_error(format!("`{}`: {error}", name("update"))))?;
        training.restore_extra_tensors(&self.file, &name(""))
    }

    /// Reads the first frames that a policy keeps from a checkpoint.
    fn episodes(
        &self,
        image_name: &str,
        vector_name: &str,
    ) -> Result<Vec<FirstFrames>, LearnerError> {
        let (spec, k) = (self.spec, self.settings.common().first_frames);
        let (shape, pixels) = self.file.read_bytes(image_name)?;
        let count = shape.first().copied().unwrap_or(0);
        // a buffer without episodes is written with zero frames
        let frames = if count == 0 { 0 } else { k };
        self.check_shape(
            image_name,
            &shape,
            &[&[count, frames], spec.image_shape.as_slice()].concat(),
        )?;
        let (vector_shape, numbers) = self.file.read_floats(vector_name)?;
        self.check_shape(vector_name, &vector_shape, &[count, frames, spec.vector_irreps.len()])?;
        let (image, vector) = (k * spec.image_len(), k * spec.vector_irreps.len());
        let episode = |i: usize| {
            let images = pixels[i * image..(i + 1) * image].to_vec();
            let vectors = numbers[i * vector..(i + 1) * vector].to_vec();
            FirstFrames::new(k, Observations { images, vectors })
        };
        Ok((0..count).map(episode).collect())
    }

    fn check_shape(
        &self,
        name: &str,
        got: &[usize],
        expected: &[usize],
    ) -> Result<(), LearnerError> {
        if got == expected {
            return Ok(());
        }
        let problem = format!("`{name}` is {got:?}, expected {expected:?}");
        Err(self.file.damaged_error(problem))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_note_may_be_longer_than_any_header() {
        let path = std::env::temp_dir().join(format!("covers-note-{}", std::process::id()));
        let note = "row\n".repeat(30_000_000);
        let header = serde_json::json!({ "settings": 1 });
        let bytes = encode_tensor_file(&path, &header, &[note_tensor(&note)]).unwrap();
        std::fs::write(&path, bytes).unwrap();
        let again = read_checkpoint_note(&path).unwrap();
        std::fs::remove_file(path).unwrap();
        assert!(again == note, "{} of {} bytes", again.len(), note.len());
    }
}
