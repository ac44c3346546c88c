// Values under the pointer, and a closer look at a part of a plot.
for (const svg of document.querySelectorAll("svg[data-edges]")) {
  const [left, top, right, bottom] = JSON.parse(svg.dataset.edges);
  const ranges = [JSON.parse(svg.dataset.x), JSON.parse(svg.dataset.y)];
  const logarithmic = JSON.parse(svg.dataset.log);
  const labels = svg.dataset.labels.split("|");
  const whole = svg.getAttribute("viewBox");
  const box = document.createElement("div");
  box.className = "plot";
  svg.replaceWith(box);
  const note = document.createElement("output");
  box.append(svg, note);

  // From a share of an axis to its value.
  const value = (axis, share) => {
    const [start, end] = ranges[axis];
    return logarithmic[axis] ? start * (end / start) ** share : start + share * (end - start);
  };
  const words = (axis, share) => {
    const unit = /\(([^)]*)\)$/.exec(labels[axis]);
    const digits = logarithmic[axis] ? 3 : 4;
    return Number(value(axis, share).toPrecision(digits)) + (unit ? " " + unit[1] : "");
  };
  const place = (event) => {
    const point = new DOMPoint(event.clientX, event.clientY);
    return point.matrixTransform(svg.getScreenCTM().inverse());
  };
  // Corners of lines and middles of dots: what is near is what was meant.
  let corners = null;
  const collect = () => {
    corners = [];
    const inside = (x, y) => x >= left && x <= right && y >= top && y <= bottom;
    for (const dot of svg.querySelectorAll("circle")) {
      corners.push([dot.cx.baseVal.value, dot.cy.baseVal.value]);
    }
    for (const line of svg.querySelectorAll("polyline")) {
      if (line.getAttribute("stroke") === "var(--grid)") continue;
      for (const point of line.points) corners.push([point.x, point.y]);
    }
    corners = corners.filter(([x, y]) => inside(x, y));
  };
  const nearest = (at) => {
    if (corners === null) collect();
    const reach = 12 / svg.getScreenCTM().a;
    let best = null, least = reach * reach;
    for (const [x, y] of corners) {
      const square = (x - at.x) ** 2 + (y - at.y) ** 2;
      if (square < least) [best, least] = [{ x, y }, square];
    }
    return best;
  };

  let from = null;
  let frame = null;
  const show = (event) => {
    const at = place(event);
    if (at.x < left || at.x > right || at.y < top || at.y > bottom) return hide();
    const there = (from === null && nearest(at)) || at;
    const along = words(0, (there.x - left) / (right - left));
    const up = words(1, (bottom - there.y) / (bottom - top));
    note.textContent = along + ", " + up;
    note.hidden = false;
    const bounds = box.getBoundingClientRect();
    const x = Math.min(event.clientX - bounds.left + 12, bounds.width - note.offsetWidth - 2);
    note.style.transform = `translate(${Math.max(0, x)}px, ${event.clientY - bounds.top - 30}px)`;
    if (from !== null) mark(at);
  };
  const hide = () => { note.hidden = true; };
  const mark = (at) => {
    if (frame === null) {
      frame = document.createElementNS(svg.namespaceURI, "rect");
      frame.setAttribute("class", "selection");
      svg.append(frame);
    }
    frame.setAttribute("x", Math.min(from.x, at.x));
    frame.setAttribute("y", Math.min(from.y, at.y));
    frame.setAttribute("width", Math.abs(at.x - from.x));
    frame.setAttribute("height", Math.abs(at.y - from.y));
  };
  const zoom = (to) => {
    const [x, y] = [Math.min(from.x, to.x), Math.min(from.y, to.y)];
    const [width, height] = [Math.abs(to.x - from.x), Math.abs(to.y - from.y)];
    const least = 20 / svg.getScreenCTM().a;
    if (width < least || height < least) return;
    svg.setAttribute("viewBox", `${x} ${y} ${width} ${height}`);
    box.classList.add("zoomed");
  };
  hide();
  svg.addEventListener("pointermove", show);
  svg.addEventListener("pointerleave", hide);
  svg.addEventListener("pointerdown", (event) => {
    // A finger scrolls the page.
    if (event.button !== 0 || event.pointerType === "touch") return show(event);
    event.preventDefault();
    svg.setPointerCapture(event.pointerId);
    from = place(event);
  });
  svg.addEventListener("pointerup", (event) => {
    if (from !== null) zoom(place(event));
    from = null;
    frame?.remove();
    frame = null;
  });
  svg.addEventListener("dblclick", () => {
    svg.setAttribute("viewBox", whole);
    box.classList.remove("zoomed");
  });
}
