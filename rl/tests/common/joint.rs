//! Networks whose critic sees all that the actor sees.

use rl::{Critic, Encoder, NetworkSettings};

/// All parts have this many fields.
pub fn joint(encoder: Encoder, fields: usize) -> NetworkSettings {
    NetworkSettings {
        encoder,
        top_fields: fields,
        vector_fields: fields,
        actor_fields: fields,
        critic: Critic::Joint { fields },
        ..NetworkSettings::default()
    }
}
