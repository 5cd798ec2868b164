const tip = document.createElement("div");
tip.id = "tip";
tip.hidden = true;
document.body.append(tip);

// the value of what the pointer is on: an attribute in HTML, an element in SVG
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

document.addEventListener("pointerover", (event) => {
  const value = valueOf(event.target);
  tip.hidden = !value;
  tip.textContent = value;
});
document.addEventListener("pointermove", (event) => {
  const left = Math.min(event.clientX + 12, innerWidth - tip.offsetWidth - 4);
  tip.style.left = `${Math.max(left, 0)}px`;
  tip.style.top = `${event.clientY + 16}px`;
});
