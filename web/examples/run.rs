//! Runs the demonstration without a browser, and prints one record (JSON) for each iteration:
//! `cargo run --release --example run -- SEED GROUPS ITERATIONS`.

use std::error::Error;

use covers_web::WorldsDemo;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<u64> =
        std::env::args().skip(1).map(|word| word.parse()).collect::<Result<_, _>>()?;
    let [seed, groups, iterations] = arguments[..] else {
        return Err("expected a seed, a number of groups and a number of iterations".into());
    };
    let mut demo = WorldsDemo::new(seed, usize::try_from(groups)?)?;
    for _ in 0..iterations {
        println!("{}", serde_json::to_string(&demo.learn()?)?);
    }
    Ok(())
}
