// Tests the built page in headless Chromium: `node tests/page.mjs FOLDER RECORDS PICTURES`. RECORDS
// are those of `examples/run.rs` for seed 1 and three groups. Screenshots go to the folder PICTURES.
import assert from "node:assert/strict";
import { createServer } from "node:http";
import { readFile, readdir, stat } from "node:fs/promises";
import { createRequire } from "node:module";
import { extname, join, normalize } from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";

import { chromium } from "playwright-core";

const [folder, records, pictures] = process.argv.slice(2);
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".wasm": "application/wasm", ".json": "application/json" };
const MAX_BYTES = 3e6;

async function weight() {
  let [total, packed] = [0, 0];
  for (const name of await readdir(folder)) {
    total += (await stat(join(folder, name))).size;
    packed += gzipSync(await readFile(join(folder, name))).length;
  }
  assert.ok(total <= MAX_BYTES, `the page has ${total} bytes, at most ${MAX_BYTES} are allowed`);
  console.log(`${total} bytes, ${packed} compressed`);
}

const server = createServer(async (request, response) => {
  const path = normalize(new URL(request.url, "http://localhost").pathname);
  try {
    const file = join(folder, path === "/" ? "index.html" : path);
    const content = await readFile(file);
    response.writeHead(200, { "content-type": TYPES[extname(file)] ?? "text/plain" }).end(content);
  } catch {
    response.writeHead(404).end();
  }
});
await new Promise((done) => server.listen(0, "127.0.0.1", done));
const address = `http://127.0.0.1:${server.address().port}/`;

const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--enable-unsafe-swiftshader", "--disable-quic", "--disable-background-networking", "--disable-component-update", "--disable-sync"],
});

async function open(options) {
  const context = await browser.newContext(options);
  const page = await context.newPage();
  const errors = [];
  page.on("pageerror", (error) => errors.push(error.message));
  page.on("console", (message) => message.type() === "error" && errors.push(message.text()));
  page.on("request", (request) => {
    if (!request.url().startsWith(address)) errors.push(`request to ${request.url()}`);
  });
  await page.goto(address);
  return { page, errors, close: () => context.close() };
}

const iterations = (page) => page.locator("#stream svg").getAttribute("aria-label");

/** Waits until the page has shown this many iterations. */
async function shown(page, number) {
  await page.waitForFunction(
    (least) => parseInt(document.querySelector("#stream svg")?.getAttribute("aria-label"), 10) >= least,
    number,
    { timeout: 120_000 },
  );
}

async function picture(page, name) {
  await page.screenshot({ path: join(pictures, `${name}.png`), fullPage: true });
}

/** Fails if an element is wider than the screen, or axe finds a fault. */
async function audit(page) {
  const [wide, all] = await page.evaluate(() => [document.documentElement.scrollWidth, innerWidth]);
  assert.ok(wide <= all, `the page is ${wide} pixels wide on a screen of ${all}`);
  await page.addScriptTag({ path: createRequire(import.meta.url).resolve("axe-core/axe.min.js") });
  const { violations } = await page.evaluate(() => window.axe.run());
  assert.deepEqual(violations.map((v) => `${v.id}: ${v.nodes[0].html}`), []);
}

await weight();

// the program without a browser learns the same tasks with the same policies
{
  const native = (await readFile(records, "utf8")).trim().split("\n").map((line) => JSON.parse(line));
  const { default: init, DemoSession } = await import(join(folder, "covers_web.js"));
  await init({ module_or_path: await readFile(join(folder, "covers_web_bg.wasm")) });
  const session = new DemoSession(1, 3);
  const choices = ({ group, policy, is_new }) => [group, policy, is_new];
  for (const record of native) assert.deepEqual(choices(JSON.parse(session.learn())), choices(record));
  assert.deepEqual(native[0].comparisons, []);
  const opening = native.find((record) => record.is_new);
  assert.ok(opening, "no policy was opened");
  const isRejected = ({ chance, verdict }) => verdict === "rejected" && chance <= opening.rejection_limit;
  assert.ok(opening.comparisons.length && opening.comparisons.every(isRejected), JSON.stringify(opening));
  assert.throws(() => session.insertVisit(3, 1, undefined), /group 3/);
  assert.throws(() => session.insertVisit(0, 0, undefined), /rounds of a visit is 0/);
  assert.throws(() => session.insertVisit(0, 1, 4), /variant is 4, expected 0 to 3/);
  for (const variant of [undefined, 0, 3]) session.insertVisit(0, 1, variant);
}

// by keyboard alone: learn, insert another group, and see a policy opened for it
{
  const { page, errors, close } = await open({ viewport: { width: 1280, height: 900 } });
  await page.locator("#play:enabled").waitFor();
  await page.locator("#speed").focus();
  await page.keyboard.press("End");
  await page.locator("#play").focus();
  await page.keyboard.press("Enter");
  await shown(page, 3);
  assert.match(await iterations(page), /, 1 policy, 100 %/);
  const first = await page.locator("#hidden-task").textContent();
  const other = first.includes("group A") ? 1 : 0;
  await page.locator("#group-buttons button").nth(other).focus();
  await page.keyboard.press("Space");
  await page.getByText(`You inserted group ${"AB"[other]}.`).waitFor();
  await page.getByText("Policy 2 is opened").waitFor({ timeout: 120_000 });
  await page.locator(".policies li", { hasText: /chance (under )?[\d.]+\s%, limit 0\.01\s%; distance 0\.\d{3}/ }).first().waitFor();
  await page.locator("#play").focus();
  await page.keyboard.press("Enter");
  assert.equal(await page.locator("#play").textContent(), "Go on");
  await audit(page);
  await picture(page, "desktop");
  assert.deepEqual(errors, []);
  await close();
}

// the same seed is the same run, and another one is not
{
  const runs = [];
  for (const seed of [1, 1, 2]) {
    const { page, close } = await open({ viewport: { width: 1024, height: 768 } });
    await page.locator("#seed").fill(String(seed));
    await page.locator("#restart").click();
    await shown(page, 4);
    await page.locator("#play").click();
    assert.ok(await page.locator("#film").evaluate((film) => film.toDataURL().length > 1000), "no film");
    const points = await page.locator("#stream .curve").getAttribute("points");
    runs.push(points.split(" ").slice(0, 4).join(" "));
    await close();
  }
  assert.equal(runs[0], runs[1]);
  assert.notEqual(runs[0], runs[2]);
}

for (const [name, options] of [
  ["phone", { viewport: { width: 390, height: 844 }, isMobile: true, hasTouch: true }],
  ["dark", { viewport: { width: 1280, height: 900 }, colorScheme: "dark" }],
  ["still", { viewport: { width: 768, height: 1024 }, reducedMotion: "reduce" }],
]) {
  const { page, errors, close } = await open(options);
  await page.locator("#play:enabled").click();
  await shown(page, 2);
  await audit(page);
  await picture(page, name);
  assert.deepEqual(errors, [], name);
  await close();
}

// the robot's tab, by keyboard: every episode shows the table and moves
{
  const { page, errors, close } = await open({ viewport: { width: 1280, height: 900 } });
  await page.locator("#tab-learn").focus();
  await page.keyboard.press("ArrowRight");
  await page.getByText("was recognised from images").waitFor();
  for (const group of await page.locator("#robot-group option").allTextContents()) {
    await page.locator("#robot-group").selectOption({ label: group });
    const seen = async () => (await page.locator("#robot-view").screenshot()).toString("base64");
    const first = await seen();
    // software rendering may take a second for a picture
    let others = 20;
    while (others > 0 && (await seen()) === first) others -= 1;
    assert.ok(others > 0, `${group} does not move`);
    await picture(page, `robot-${group}`);
  }
  await audit(page);
  assert.deepEqual(errors, []);
  await close();
}

// the report's script: arrow keys show what stands behind a point, and Escape hides it
{
  const page = await browser.newPage();
  await page.setContent('<figure class="chart" tabindex="0"><svg><circle r="9"><title>seed 0: 0.50</title></circle></svg></figure>');
  await page.addScriptTag({ path: fileURLToPath(new URL("../../report/src/page.js", import.meta.url)) });
  const tip = page.locator("#tip");
  await page.locator(".chart").focus();
  await page.keyboard.press("ArrowRight");
  assert.equal(await tip.textContent(), "seed 0: 0.50");
  assert.ok(await tip.isVisible());
  await page.keyboard.press("Escape");
  assert.ok(await tip.isHidden(), "Escape leaves the tip");
  await page.mouse.move(200, 200);
  await page.locator("circle").hover();
  await tip.waitFor();
  await page.keyboard.press("Escape");
  assert.ok(await tip.isHidden(), "Escape leaves the tip of the pointer");
  await page.close();
}

await browser.close();
server.close();
console.log("the page works");
