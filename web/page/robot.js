// Plays recorded episodes of the robot in three dimensions.
import {
  AmbientLight, BoxGeometry, CapsuleGeometry, Color, CylinderGeometry, DirectionalLight, Group, Mesh,
  MeshStandardMaterial, PCFShadowMap, PerspectiveCamera, Quaternion, Scene, SphereGeometry, Vector3,
  WebGLRenderer,
} from "three";

const element = (id) => document.getElementById(id);
// where the camera looks, its distance and its height over the table (metres)
const TARGET = new Vector3(0, 0, 0.1);
const DISTANCE = 1.45;
const HEIGHT = 0.85;
// the end of an episode is held for a moment (seconds)
const PAUSE = 1;
const GOAL_RADIUS = 0.02;
const VARIANTS = { identity: "no", "flip x": "left and right", "flip y": "front and back", "half turn": "both: half a turn" };

/** Returns the mesh of a recorded shape; MuJoCo's shapes lie along z, those of three.js along y. */
function mesh({ shape, size, rgba }) {
  const [r, h] = size;
  const geometry = {
    box: () => new BoxGeometry(2 * size[0], 2 * size[1], 2 * size[2]),
    sphere: () => new SphereGeometry(r, 24, 16),
    cylinder: () => new CylinderGeometry(r, r, 2 * h, 32).rotateX(Math.PI / 2),
    capsule: () => new CapsuleGeometry(r, 2 * h, 8, 24).rotateX(Math.PI / 2),
  }[shape]();
  const [red, green, blue, opacity] = rgba;
  const material = new MeshStandardMaterial({ color: new Color().setRGB(red, green, blue, "srgb"), roughness: 0.7, opacity, transparent: opacity < 1 });
  const solid = new Mesh(geometry, material);
  solid.castShadow = opacity === 1;
  solid.receiveShadow = true;
  return solid;
}

/** Loads the episodes and shows the first; if the visitor wants little motion, it stands still. */
export async function show(isStill) {
  const episodes = await (await fetch("poses.json")).json();
  const canvas = element("robot-view");
  const renderer = new WebGLRenderer({ canvas, antialias: true });
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = PCFShadowMap;
  const scene = new Scene();
  scene.background = new Color("#dfe5ea");
  const sun = new DirectionalLight("white", 2.2);
  sun.position.set(0.8, -0.9, 2);
  sun.castShadow = true;
  sun.shadow.mapSize.set(2048, 2048);
  Object.assign(sun.shadow.camera, { left: -1, right: 1, top: 1, bottom: -1, near: 0.1, far: 5 });
  scene.add(sun, new AmbientLight("white", 1.1));
  const camera = new PerspectiveCamera(40, 1, 0.01, 20);
  camera.up.set(0, 0, 1);

  const groups = [...new Set(episodes.map((episode) => episode.group))];
  const option = (text, value) => new Option(text, value);
  element("robot-group").replaceChildren(...groups.map((group) => option(group.replaceAll("-", " "), group)));
  element("robot-variant").replaceChildren(...Object.entries(VARIANTS).map(([variant, text]) => option(text, variant)));

  let [episode, solids, time, isPlaying, latest] = [undefined, new Group(), 0, !isStill, undefined];
  scene.add(solids);

  const choose = () => {
    const [group, variant] = [element("robot-group").value, element("robot-variant").value];
    episode = episodes.find((one) => one.group === group && one.variant === variant);
    for (const old of solids.children) {
      old.geometry.dispose();
      old.material.dispose();
    }
    solids.clear();
    solids.add(...episode.solids.map(mesh));
    if (episode.goal) {
      const goal = mesh({ shape: "sphere", size: [GOAL_RADIUS], rgba: [0.1, 0.7, 0.3, 0.6] });
      goal.position.fromArray(episode.goal);
      solids.add(goal);
    }
    time = 0;
    element("robot-status").textContent = `Policy ${episode.policy + 1} was recognised from images. ${episode.success ? "It solves the task." : "It does not solve the task."}`;
  };

  const length = () => Math.max(...episode.solids.map((solid) => solid.poses.length)) - 1;

  /** Places the solids between two recorded poses. */
  const pose = () => {
    const position = Math.min(time / episode.seconds, length());
    episode.solids.forEach(({ poses }, index) => {
      const from = Math.min(Math.floor(position), poses.length - 1);
      const [a, b] = [poses[from], poses[Math.min(from + 1, poses.length - 1)]];
      const share = position - Math.floor(position);
      const solid = solids.children[index];
      solid.position.fromArray(a).lerp(new Vector3().fromArray(b), share);
      solid.quaternion.fromArray(a, 3).slerp(new Quaternion().fromArray(b, 3), share).normalize();
    });
  };

  const draw = (now) => {
    requestAnimationFrame(draw);
    if (canvas.clientWidth === 0) return;
    if (isPlaying && latest !== undefined) time += (now - latest) / 1000;
    latest = now;
    if (time > length() * episode.seconds + PAUSE) time = 0;
    const width = canvas.clientWidth;
    renderer.setPixelRatio(devicePixelRatio);
    renderer.setSize(width, Math.round(width * 0.6), false);
    camera.aspect = 1 / 0.6;
    camera.updateProjectionMatrix();
    const angle = (element("robot-angle").valueAsNumber * Math.PI) / 180;
    camera.position.set(TARGET.x + DISTANCE * Math.sin(-angle), TARGET.y - DISTANCE * Math.cos(angle), TARGET.z + HEIGHT);
    camera.lookAt(TARGET);
    pose();
    renderer.render(scene, camera);
  };

  const setPlaying = (value) => {
    isPlaying = value;
    element("robot-play").textContent = value ? "Pause" : "Play";
  };
  setPlaying(isPlaying);
  element("robot-play").addEventListener("click", () => setPlaying(!isPlaying));
  for (const id of ["robot-group", "robot-variant"]) element(id).addEventListener("change", choose);
  canvas.addEventListener("pointermove", ({ buttons, movementX }) => {
    const angle = element("robot-angle");
    if (buttons) angle.valueAsNumber = ((angle.valueAsNumber - movementX / 2 + 540) % 360) - 180;
  });
  choose();
  requestAnimationFrame(draw);
}
