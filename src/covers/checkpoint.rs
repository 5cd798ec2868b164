//! The learner as one file: everything that its next rollout depends on.

use std::borrow::Cow;
use std::path::Path;

use cluster::{Assigner, Reservoir};
use rl::{ActorCriticPolicy, Adam, EnvSpec, Observations, Policy, Ppo, RolloutBuffer};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};

use super::{Covers, CoversSettings, Embedding, Member, Seconds, Streams};
use crate::CoversError;
use crate::first_frames::FirstFrames;

/// The key of the metadata. There is no second one, whose order could vary: equal learners give equal bytes.
const METADATA: &str = "covers 1";

/// What is not an array.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header<'a> {
    settings: Cow<'a, CoversSettings>,
    current: usize,
    streams: Cow<'a, Streams>,
    members: Vec<MemberHeader>,
    note: Cow<'a, str>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MemberHeader {
    /// Steps of the optimiser; none where its moments were left out.
    adam_steps: Option<u64>,
    /// Episodes offered to the buffer so far.
    seen: u64,
}

/// How much of a learner is saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// All of it: the copy learns on to the same bits.
    Everything,
    /// What acting and recognising take: policies, and the first frames of at most this many episodes each. A copy that learns on starts with
    /// fresh optimisers.
    Policies {
        /// Episodes a policy, at least 1.
        episodes: usize,
    },
}

/// One array of the file.
struct Tensor {
    name: String,
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Covers {
    /// Writes the learner to a safetensors file, with a note of the caller's. The file appears whole or not at all.
    ///
    /// # Errors
    /// [`CoversError::Write`].
    pub fn save(&self, path: &Path, extent: Extent, note: &str) -> Result<(), CoversError> {
        let header = Header {
            settings: Cow::Borrowed(&self.settings),
            current: self.current,
            streams: Cow::Borrowed(&self.streams),
            members: self.members.iter().map(|m| m.header(extent)).collect(),
            note: Cow::Borrowed(note),
        };
        let members = self.members.iter().enumerate();
        let tensors: Vec<Tensor> = members
            .flat_map(|(index, member)| member.tensors(index, &self.spec, extent))
            .collect();
        let header = serde_json::to_string(&header).map_err(|e| CoversError::write(path, e))?;
        let bytes = encode(&tensors, header).map_err(|e| CoversError::write(path, e))?;
        replace(path, &bytes).map_err(|error| CoversError::write(path, error))
    }

    /// Reads what [`Covers::save`] wrote, for environments like those it learnt in; returns the note, too.
    ///
    /// # Errors
    /// [`CoversError::Read`] for a file that is missing, damaged, or belongs to other environments.
    pub fn load(path: &Path, spec: &EnvSpec) -> Result<(Self, String), CoversError> {
        Self::load_if(path, spec, |_| Ok(()))
    }

    /// As [`Covers::load`], for a copy that learns on to the same bits.
    ///
    /// # Errors
    /// As there, and [`CoversError::PoliciesOnly`] for a file of [`Extent::Policies`].
    pub(crate) fn load_everything(
        path: &Path,
        spec: &EnvSpec,
    ) -> Result<(Self, String), CoversError> {
        Self::load_if(path, spec, |header| {
            if header.members.iter().all(|m| m.adam_steps.is_some()) {
                return Ok(());
            }
            Err(CoversError::PoliciesOnly {
                path: path.to_owned(),
            })
        })
    }

    fn load_if(
        path: &Path,
        spec: &EnvSpec,
        check: impl Fn(&Header<'_>) -> Result<(), CoversError>,
    ) -> Result<(Self, String), CoversError> {
        let bytes = std::fs::read(path).map_err(|error| CoversError::read(path, error))?;
        let (header, file) = decode(&bytes).map_err(|error| CoversError::read(path, error))?;
        check(&header)?;
        let settings = header.settings.into_owned();
        let arrays = Arrays {
            path,
            file,
            spec,
            settings: &settings,
        };
        let members: Vec<Member> = header
            .members
            .iter()
            .enumerate()
            .map(|(index, member)| arrays.member(index, member))
            .collect::<Result<_, _>>()?;
        if header.current >= members.len() {
            let problem = format!("policy {} of {}", header.current, members.len());
            return Err(CoversError::read(path, Damaged(problem)));
        }
        let steps = settings.steps_per_env(spec)?;
        let covers = Self {
            spec: spec.clone(),
            assigner: Assigner::new(settings.assigner)?,
            members,
            current: header.current,
            rollout: RolloutBuffer::new(spec, steps)?,
            streams: header.streams.into_owned(),
            seconds: Seconds::default(),
            settings,
        };
        Ok((covers, header.note.into_owned()))
    }
}

impl Member {
    fn header(&self, extent: Extent) -> MemberHeader {
        match extent {
            Extent::Everything => MemberHeader {
                adam_steps: Some(self.ppo.optimiser().steps),
                seen: self.buffer.seen(),
            },
            Extent::Policies { .. } => MemberHeader {
                adam_steps: None,
                seen: self.kept(extent).len() as u64,
            },
        }
    }

    /// The episodes that are saved. Whichever they are, they are a uniform sample.
    fn kept(&self, extent: Extent) -> &[FirstFrames] {
        let all = self.buffer.episodes();
        match extent {
            Extent::Everything => all,
            Extent::Policies { episodes } => &all[..episodes.min(all.len())],
        }
    }

    fn tensors(&self, index: usize, spec: &EnvSpec, extent: Extent) -> Vec<Tensor> {
        let name = |what: &str| format!("policy.{index}.{what}");
        let optimiser = self.ppo.optimiser();
        let mut tensors = vec![Tensor::floats(
            name("params"),
            vec![self.policy.params().len()],
            self.policy.params(),
        )];
        if extent == Extent::Everything {
            for (what, moment) in [
                ("adam.first", &optimiser.first_moment),
                ("adam.second", &optimiser.second_moment),
            ] {
                tensors.push(Tensor::floats(name(what), vec![moment.len()], moment));
            }
        }
        let episodes = self.kept(extent);
        let frames = episodes.first().map_or(0, FirstFrames::count);
        let observations = episodes.iter().map(FirstFrames::observations);
        let images = observations.clone().flat_map(|o| o.images.iter().copied());
        let vectors: Vec<f32> = observations.flat_map(|o| o.vectors.clone()).collect();
        let rows = [episodes.len(), frames];
        tensors.push(Tensor {
            name: name("images"),
            dtype: Dtype::U8,
            shape: [&rows, spec.image.as_slice()].concat(),
            bytes: images.collect(),
        });
        let shape = [&rows, [spec.vector.len()].as_slice()].concat();
        tensors.push(Tensor::floats(name("vectors"), shape, &vectors));
        let features = episodes.iter().flat_map(|e| e.features().unwrap_or(&[]));
        let features: Vec<f32> = features.copied().collect();
        if !features.is_empty() {
            let dim = self.policy.feature_dim();
            tensors.push(Tensor::floats(
                name("features"),
                [&rows, [dim].as_slice()].concat(),
                &features,
            ));
        }
        tensors
    }
}

impl Tensor {
    fn floats(name: String, shape: Vec<usize>, values: &[f32]) -> Self {
        Self {
            name,
            dtype: Dtype::F32,
            shape,
            bytes: values.iter().flat_map(|v| v.to_le_bytes()).collect(),
        }
    }
}

/// The arrays of an open file, and what they must fit.
struct Arrays<'a> {
    path: &'a Path,
    file: SafeTensors<'a>,
    spec: &'a EnvSpec,
    settings: &'a CoversSettings,
}

impl Arrays<'_> {
    fn member(&self, index: usize, header: &MemberHeader) -> Result<Member, CoversError> {
        let name = |what: &str| format!("policy.{index}.{what}");
        let (network, ppo) = (&self.settings.network, self.settings.ppo.clone());
        let params = self.floats(&name("params"))?;
        let policy = ActorCriticPolicy::with_params(network, self.spec, params)?;
        let ppo = match header.adam_steps {
            None => Ppo::new(ppo, &policy)?,
            Some(steps) => {
                let optimiser = Adam {
                    steps,
                    first_moment: self.floats(&name("adam.first"))?,
                    second_moment: self.floats(&name("adam.second"))?,
                    ..Adam::new(0, ppo.adam_epsilon)
                };
                Ppo::resume(ppo, &policy, optimiser)?
            }
        };
        let mut features = Vec::new();
        if self.settings.embedding == Embedding::AtArrival && header.seen > 0 {
            features = self.floats(&name("features"))?;
        }
        let episodes = self.episodes(&name("images"), &name("vectors"), &features)?;
        let capacity = self.settings.buffer_capacity();
        let buffer = Reservoir::from_parts(capacity, header.seen, episodes)?;
        Ok(Member {
            policy,
            ppo,
            buffer,
        })
    }

    fn episodes(
        &self,
        images: &str,
        vectors: &str,
        features: &[f32],
    ) -> Result<Vec<FirstFrames>, CoversError> {
        let pixels = self.tensor(images, Dtype::U8)?;
        let (shape, expected) = (pixels.shape(), self.spec.image);
        if shape.len() != 5 || shape[2..] != expected {
            let problem = format!("`{images}` is {shape:?}, expected [_, _, {expected:?}]");
            return Err(CoversError::read(self.path, Damaged(problem)));
        }
        let (count, frames) = (shape[0], shape[1]);
        let numbers = self.floats(vectors)?;
        let (image, vector) = (
            frames * self.spec.image_len(),
            frames * self.spec.vector.len(),
        );
        if numbers.len() != count * vector {
            let problem = format!(
                "`{vectors}` holds {}, expected {}",
                numbers.len(),
                count * vector
            );
            return Err(CoversError::read(self.path, Damaged(problem)));
        }
        let episode = |i: usize| {
            let observations = Observations {
                images: pixels.data()[i * image..(i + 1) * image].to_vec(),
                vectors: numbers[i * vector..(i + 1) * vector].to_vec(),
            };
            let kept = features
                .chunks_exact((features.len() / count).max(1))
                .nth(i);
            FirstFrames::new(frames, observations, kept.map(<[f32]>::to_vec))
        };
        Ok((0..count).map(episode).collect())
    }

    fn floats(&self, name: &str) -> Result<Vec<f32>, CoversError> {
        let tensor = self.tensor(name, Dtype::F32)?;
        let (numbers, _) = tensor.data().as_chunks::<4>();
        Ok(numbers
            .iter()
            .map(|bytes| f32::from_le_bytes(*bytes))
            .collect())
    }

    fn tensor(&self, name: &str, dtype: Dtype) -> Result<TensorView<'_>, CoversError> {
        let tensor = self.file.tensor(name);
        let tensor = tensor.map_err(|error| CoversError::read(self.path, error))?;
        if tensor.dtype() == dtype {
            return Ok(tensor);
        }
        let problem = format!("`{name}` is {:?}, expected {dtype:?}", tensor.dtype());
        Err(CoversError::read(self.path, Damaged(problem)))
    }
}

fn encode(tensors: &[Tensor], header: String) -> Result<Vec<u8>, safetensors::SafeTensorError> {
    let views: Vec<_> = tensors
        .iter()
        .map(|t| {
            Ok((
                &t.name,
                TensorView::new(t.dtype, t.shape.clone(), &t.bytes)?,
            ))
        })
        .collect::<Result<_, safetensors::SafeTensorError>>()?;
    let metadata = [(METADATA.to_owned(), header)].into_iter().collect();
    safetensors::serialize(views, Some(metadata))
}

fn decode(bytes: &[u8]) -> Result<(Header<'static>, SafeTensors<'_>), Damaged> {
    let damaged = |error: safetensors::SafeTensorError| Damaged(error.to_string());
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
    let header = metadata.metadata().as_ref().and_then(|m| m.get(METADATA));
    let header = header.ok_or_else(|| Damaged(format!("there is no metadata `{METADATA}`")))?;
    let header = serde_json::from_str(header).map_err(|e| Damaged(e.to_string()))?;
    Ok((header, SafeTensors::deserialize(bytes).map_err(damaged)?))
}

/// Writes a file beside `path` and renames it: an interruption leaves the old one.
fn replace(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let partial = path.with_extension("partial");
    std::fs::write(&partial, bytes)?;
    std::fs::rename(partial, path)
}

/// What is wrong with a file that could be read.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Damaged(String);
