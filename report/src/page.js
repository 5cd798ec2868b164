// figures of what the pointer or the arrow keys are on
const tip = document.createElement("div");
tip.id = "tip";
tip.role = "status";
tip.hidden = true;
document.body.append(tip);

// an attribute in HTML, an element in SVG
const valueOf = (target) => {
  const own = target.closest("[title], [data-value]");
  if (own) {
    // the browser's own tip would come on top
    own.dataset.value ??= own.title;
    own.removeAttribute("title");
    return own.dataset.value;
  }
  const title = target.closest("svg") && target.querySelector(":scope > title");
  return target.tagName !== "svg" && title ? title.textContent : "";
};

const show = (value, x, y) => {
  tip.hidden = !value;
  tip.textContent = value;
  tip.style.left = `${Math.max(Math.min(x + 12, innerWidth - tip.offsetWidth - 4), 0)}px`;
  tip.style.top = `${y + 16}px`;
};
for (const event of ["pointerover", "pointermove"]) {
  document.addEventListener(event, ({ target, clientX, clientY, pointerType, movementX, movementY }) => {
    // a page that scrolls under a resting mouse must not hide what the keys show
    if (pointerType === "mouse" && !movementX && !movementY) return;
    show(valueOf(target), clientX, clientY);
  });
}

addEventListener("keydown", ({ key }) => {
  if (key === "Escape") show("", 0, 0);
});

for (const chart of document.querySelectorAll(".chart")) {
  const points = [...chart.querySelectorAll("circle")];
  let at = -1;
  chart.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step || !points.length) return;
    event.preventDefault();
    at = (Math.max(at + step, -1) + points.length) % points.length;
    const { right, bottom } = points[at].getBoundingClientRect();
    show(valueOf(points[at]), right, bottom);
  });
  chart.addEventListener("blur", () => show("", 0, 0));
}

// cells without a figure come last, in either order
const keyOf = (row, column) => {
  const text = row.cells[column].textContent;
  const number = text === "never" ? Infinity : parseFloat(text.replace(/^[<([ ]+/, ""));
  return Number.isNaN(number) ? text : number;
};
const compare = (one, other, sign) => {
  if (typeof one !== typeof other) return typeof one === "number" ? -1 : 1;
  return sign * (typeof one === "number" ? one - other || 0 : one.localeCompare(other));
};
for (const table of document.querySelectorAll(".sortable")) {
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const sign = head.ariaSort === "ascending" ? -1 : 1;
      for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
      head.ariaSort = sign > 0 ? "ascending" : "descending";
      const rows = [...table.tBodies[0].rows];
      rows.sort((one, other) => compare(keyOf(one, column), keyOf(other, column), sign));
      table.tBodies[0].append(...rows);
    });
  });
}

for (const film of document.querySelectorAll(".film img")) {
  const still = document.createElement("canvas");
  still.role = "img";
  still.ariaLabel = film.alt;
  const button = document.createElement("button");
  button.type = "button";
  const move = (moving) => {
    film.hidden = !moving;
    still.hidden = moving;
    button.textContent = moving ? "Pause" : "Play";
    if (moving) return;
    [still.width, still.height] = [film.naturalWidth, film.naturalHeight];
    still.getContext("2d").drawImage(film, 0, 0);
  };
  film.after(still, button);
  button.addEventListener("click", () => move(film.hidden));
  film.decode().then(() => move(!matchMedia("(prefers-reduced-motion: reduce)").matches));
}

addEventListener("beforeprint", () => {
  for (const run of document.querySelectorAll("details")) run.open = true;
});
