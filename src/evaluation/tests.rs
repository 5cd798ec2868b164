use super::*;

#[test]
fn what_the_learner_draws_is_not_what_places_the_episodes() {
    use rand::RngExt;
    let words = |mut rng: ChaCha8Rng| -> [u64; 2] { [rng.random(), rng.random()] };
    let placing = |index| {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        rng.set_stream(index);
        words(rng)
    };
    assert!((0..1000).all(|index| placing(index) != words(looking(7))));
}
