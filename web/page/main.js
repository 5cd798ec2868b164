// The page: asks the worker for iterations, plays their films and draws the stream.

const SIDE = 48;
const FILMED = 4;
const PICTURE = SIDE * SIDE * 3;
// from the palette of Okabe and Ito, which people with colour blindness can tell apart
const COLOURS = ["#e69f00", "#56b4e9", "#009e73", "#f0e442", "#cc79a7", "#d55e00"];
const NEUTRAL = "#b4bcc6";
// pictures a second of the film, by position of the slider; the last skips the films
const SPEEDS = [6, 12, 25, 60, Infinity];
// iterations that may wait to be shown
const AHEAD = 2;
const INSERTED_ROUNDS = 6;

const element = (id) => document.getElementById(id);
const letter = (group) => String.fromCharCode(65 + group);
const percent = (share) => `${Math.round(100 * share)} %`;
const smallPercent = (share) => `${share < 1e-6 ? "under 0.0001" : Number((100 * share).toPrecision(2))}\u00a0%`;
const isStill = matchMedia("(prefers-reduced-motion: reduce)");

const worker = new Worker("worker.js", { type: "module" });
let run = 0;
let state;

/** Begins a run: the worker draws its world and shows one picture of each group. */
function begin() {
  run += 1;
  const groups = element("groups").valueAsNumber;
  state = { groups, records: [], waiting: [], asked: 0, policies: [], isPlaying: false, isReady: false, hasFailed: false };
  element("log").replaceChildren();
  element("play").disabled = true;
  send("start", { seed: element("seed").valueAsNumber, groups });
  draw();
}

function send(type, values = {}) {
  worker.postMessage({ run, type, ...values });
}

/** Asks for iterations while few wait to be shown. */
function ask() {
  while (state.isPlaying && state.isReady && state.asked + state.waiting.length < AHEAD) {
    state.asked += 1;
    send("learn");
  }
}

worker.onmessage = ({ data }) => {
  if (data.run !== run) return;
  if (data.type === "start") {
    state.isReady = true;
    element("play").disabled = false;
    showGroups(data.pictures);
    ask();
  } else if (data.type === "learn") {
    state.asked -= 1;
    state.waiting.push(data);
  } else if (data.type === "insert") {
    say(`You inserted group ${letter(data.group)}.`);
  } else {
    state.hasFailed = true;
    setPlaying(false);
    element("status").textContent = `The run ended with an error: ${data.message}`;
  }
};

worker.onerror = () => {
  element("status").textContent = "The learner could not be started. This page needs a browser with WebAssembly SIMD, and a web server: it cannot be opened as a file.";
};

function setPlaying(isPlaying) {
  state.isPlaying = isPlaying && !state.hasFailed;
  if (isPlaying || state.records.length) element("play").textContent = state.isPlaying ? "Pause" : "Go on";
  ask();
}

/** Draws picture `at` of bytes `[N, 48, 48, 3]` at (x, y) of a canvas. */
function paint(canvas, bytes, at, x, y) {
  const image = new ImageData(SIDE, SIDE);
  for (let i = 0; i < SIDE * SIDE; i += 1) {
    const from = at * PICTURE + 3 * i;
    image.data.set([bytes[from], bytes[from + 1], bytes[from + 2], 255], 4 * i);
  }
  canvas.getContext("2d").putImageData(image, x, y);
}

function showGroups(pictures) {
  const buttons = pictures.map((bytes, group) => {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = SIDE;
    paint(canvas, bytes, 0, 0, 0);
    const button = document.createElement("button");
    button.type = "button";
    button.append(canvas, badge(letter(group), group));
    button.setAttribute("aria-label", `Insert a visit of group ${letter(group)}`);
    button.addEventListener("click", () => {
      const variant = element("variant").value;
      send("insert", { group, rounds: INSERTED_ROUNDS, variant: variant === "" ? undefined : Number(variant) });
    });
    return button;
  });
  element("group-buttons").replaceChildren(...buttons);
}

function badge(text, group) {
  const span = document.createElement("span");
  span.className = "badge";
  span.style.background = group === undefined ? NEUTRAL : COLOURS[group];
  span.textContent = text;
  return span;
}

function say(text) {
  const item = document.createElement("li");
  item.textContent = text;
  element("log").prepend(item);
}

/** Returns the group that a policy learnt most often, or undefined if it has not trained. */
function groupOf(policy) {
  const counts = state.policies[policy]?.counts ?? [];
  const most = Math.max(0, ...counts);
  return most > 0 ? counts.indexOf(most) : undefined;
}

/** Takes an iteration into the page's records, and says what is worth saying. */
function take(record) {
  const earlier = state.records.at(-1);
  state.records.push(record);
  while (state.policies.length <= record.policy) state.policies.push({ counts: Array(state.groups).fill(0), success: 0 });
  const policy = state.policies[record.policy];
  const number = record.policy + 1;
  const before = `Iteration ${record.iteration + 1}: `;
  if (!earlier) say(`${before}the first policy begins to learn.`);
  else if (record.is_new) say(`${before}the images are unlike all that was seen. Policy ${number} is opened.`);
  else if (record.policy !== earlier.policy) say(`${before}recognised. Policy ${number} is used again.`);
  else if (record.group !== earlier.group) say(`${before}the group changed, and the learner has not noticed.`);
  policy.counts[record.group] += 1;
  policy.success = record.success;
  const merged = (record.merged_into ?? []).map((into) => into ?? undefined);
  state.policies.forEach((own, index) => {
    if (merged[index] !== undefined && own.into === undefined) say(`${before}policy ${index + 1} was merged into policy ${merged[index] + 1}.`);
    own.into = merged[index];
  });
  element("status").textContent = `Iteration ${record.iteration + 1}: policy ${number} learns, ${percent(record.success)} of its episodes succeed.`;
  element("hidden-task").textContent = `Hidden from the learner: this is group ${letter(record.group)}.`;
}

/** Returns the evidence against a policy: a bar with the limit in its middle, and the numbers. */
function evidence({ distance, chance, verdict }, limit) {
  const bar = document.createElement("div");
  bar.className = "bar";
  bar.setAttribute("aria-hidden", "true");
  const fill = document.createElement("span");
  fill.style.width = `${Math.min((50 * Math.log(chance)) / Math.log(limit), 100)}%`;
  bar.append(fill);
  const numbers = document.createElement("small");
  numbers.textContent = `${verdict}: chance ${smallPercent(chance)}, limit ${smallPercent(limit)}; distance ${distance.toFixed(3)}`;
  return [bar, numbers];
}

function drawPolicies(record) {
  const items = state.policies.map((policy, index) => {
    const item = document.createElement("li");
    const isActive = record?.policy === index;
    if (isActive) item.setAttribute("aria-current", "true");
    if (policy.into !== undefined) item.className = "merged";
    const group = groupOf(index);
    const text = document.createElement("span");
    const serves = group === undefined ? "has not trained yet" : `serves group ${letter(group)}`;
    text.textContent = policy.into !== undefined ? `merged into policy ${policy.into + 1}` : `${serves}${isActive ? ", active" : ""}`;
    const success = document.createElement("span");
    success.textContent = percent(policy.success);
    item.append(badge(index + 1, group), text, success);
    const compared = record?.comparisons[index];
    if (typeof compared?.chance === "number" && policy.into === undefined) item.append(...evidence(compared, record.rejection_limit));
    return item;
  });
  element("policies").replaceChildren(...items);
}

/** Draws the stream: groups, policies and success, over all iterations. */
function drawStream() {
  const { records } = state;
  const [width, left, top] = [Math.max(element("stream").clientWidth, 240), 52, 58];
  const step = (width - left - 10) / Math.max(records.length, 30);
  const shape = (name, attributes, text) => {
    const node = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text !== undefined) node.textContent = text;
    return node;
  };
  const svg = shape("svg", { viewBox: `0 0 ${width} 170`, role: "img", "aria-label": summary() });
  const y = (success) => top + 95 * (1 - success);
  for (const [label, at] of [["group", 16], ["policy", 40]]) svg.append(shape("text", { x: 0, y: at }, label));
  for (const success of [0, 0.5, 1]) {
    svg.append(shape("line", { class: "axis", x1: left, x2: width - 10, y1: y(success), y2: y(success) }));
    svg.append(shape("text", { x: left - 6, y: y(success) + 4, "text-anchor": "end" }, percent(success)));
  }
  const cells = (key, at, colour, label) => {
    let first = 0;
    records.forEach((record, i) => {
      if (records[i + 1]?.[key] === record[key]) return;
      const [x, wide] = [left + first * step, (i + 1 - first) * step];
      svg.append(shape("rect", { x, y: at, width: Math.max(wide - 1, 0.5), height: 20, fill: colour(record[key]) }));
      if (wide > 14) svg.append(shape("text", { x: x + wide / 2, y: at + 14, "text-anchor": "middle", style: "fill: #10151a" }, label(record[key])));
      first = i + 1;
    });
  };
  cells("group", 2, (group) => COLOURS[group], letter);
  cells("policy", 26, (policy) => COLOURS[groupOf(policy)] ?? NEUTRAL, (policy) => policy + 1);
  const points = records.map((record, i) => `${left + (i + 0.5) * step},${y(record.success)}`);
  svg.append(shape("polyline", { class: "curve", points: points.join(" ") }));
  svg.append(shape("text", { x: width - 10, y: 168, "text-anchor": "end" }, `${records.length} iterations of 500 decisions`));
  element("stream").replaceChildren(svg);
}

function summary() {
  const { records, policies } = state;
  if (!records.length) return "No iteration yet";
  const right = records.filter((record) => groupOf(record.policy) === record.group).length;
  const count = policies.length === 1 ? "1 policy" : `${policies.length} policies`;
  return `${records.length} iterations, ${count}, ${percent(right / records.length)} of the iterations learnt by the policy of their group`;
}

function draw() {
  drawPolicies(state.records.at(-1));
  drawStream();
}

// The film that is shown, its next picture, and the time of the latest one.
let shown;
let next = 0;
let since = 0;

function tick(now) {
  requestAnimationFrame(tick);
  const speed = SPEEDS[element("speed").valueAsNumber];
  const pictures = shown ? shown.length / (FILMED * PICTURE) : 0;
  const isOver = next >= pictures || speed === Infinity;
  if (state.isPlaying && isOver && state.waiting.length) {
    const { record, film } = state.waiting.shift();
    take(record);
    draw();
    shown = film;
    // the last picture says the most where nothing may move
    next = speed === Infinity || isStill.matches ? film.length / (FILMED * PICTURE) - 1 : 0;
    since = 0;
    ask();
  }
  if (shown && next < shown.length / (FILMED * PICTURE) && now - since >= 1000 / speed) {
    for (let i = 0; i < FILMED; i += 1) {
      paint(element("film"), shown, next * FILMED + i, (i % 2) * 49, Math.floor(i / 2) * 49);
    }
    since = now;
    next += 1;
  }
}

element("play").addEventListener("click", () => setPlaying(!state.isPlaying));
element("settings").addEventListener("submit", (event) => {
  event.preventDefault();
  begin();
  setPlaying(true);
});
// arrows choose a tab, as the pattern of the WAI-ARIA guide says
const tabs = [...document.querySelectorAll("[role=tab]")];
let robot;

function choose(tab) {
  for (const other of tabs) {
    other.setAttribute("aria-selected", String(other === tab));
    other.tabIndex = other === tab ? 0 : -1;
    element(other.getAttribute("aria-controls")).hidden = other !== tab;
  }
  if (tab.id === "tab-robot") {
    setPlaying(false);
    // loaded on demand: most of the page's weight
    robot ??= import("./robot.js").then(({ show }) => show(isStill.matches));
    robot.catch((error) => {
      element("robot-status").textContent = `The robot cannot be shown: ${error.message}`;
    });
  } else {
    drawStream();
  }
}

tabs.forEach((tab, index) => {
  tab.addEventListener("click", () => choose(tab));
  tab.addEventListener("keydown", ({ key }) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[key];
    if (!step) return;
    const next = tabs[(index + step + tabs.length) % tabs.length];
    choose(next);
    next.focus();
  });
});

addEventListener("resize", drawStream);
element("film").width = element("film").height = 2 * SIDE + 1;
begin();
requestAnimationFrame(tick);
