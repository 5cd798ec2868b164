// Runs the learner beside the page, so that the page never waits. It learns one iteration for each
// message `learn`, and answers with what happened.
import init, { DemoSession } from "./covers_web.js";

let session;

const answers = {
  async start({ seed, groups }) {
    await init({ module_or_path: new URL("covers_web_bg.wasm", import.meta.url) });
    session?.free();
    session = new DemoSession(seed, groups);
    const pictures = Array.from({ length: groups }, (_, group) => session.groupPicture(group));
    return { pictures };
  },
  learn() {
    const record = JSON.parse(session.learn());
    return { record, film: session.rolloutFilm() };
  },
  insert({ group, rounds, variant }) {
    session.insertVisit(group, rounds, variant);
    return { group };
  },
};

// one after another: a message must not overtake `start`, which loads the program
let last = Promise.resolve();

onmessage = ({ data }) => {
  last = last.then(async () => {
    try {
      postMessage({ run: data.run, type: data.type, ...(await answers[data.type](data)) });
    } catch (error) {
      postMessage({ run: data.run, type: "error", message: String(error.message ?? error) });
    }
  });
};
