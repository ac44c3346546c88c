// Points and paths in space, turned by the pointer; plain canvas, so that it runs wherever a page opens.
for (const figure of document.querySelectorAll("figure.scene")) {
  const canvas = figure.querySelector("canvas");
  const data = JSON.parse(figure.querySelector("script").textContent);
  const context = canvas.getContext("2d");
  const start = { yaw: -0.6, pitch: 0.9, zoom: 1, shift: [0, 0] };
  let view = structuredClone(start);
  const shades = 5;
  let low = Infinity, high = -Infinity;
  for (let i = 2; i < data.cloud.length; i += 3) {
    low = Math.min(low, data.cloud[i]);
    high = Math.max(high, data.cloud[i]);
  }
  // How far the whole scene reaches to the sides and up in the first view, so that all of it is in sight.
  const reach = [1, 1];
  for (const list of [data.cloud, ...data.paths.flatMap((path) => path.pieces)]) {
    for (let i = 0; i < list.length; i += 3) {
      const along = Math.cos(start.yaw) * list[i] - Math.sin(start.yaw) * list[i + 1];
      const away = Math.sin(start.yaw) * list[i] + Math.cos(start.yaw) * list[i + 1];
      const up = Math.sin(start.pitch) * away + Math.cos(start.pitch) * list[i + 2];
      reach[0] = Math.max(reach[0], Math.abs(along));
      reach[1] = Math.max(reach[1], Math.abs(up));
    }
  }
  const color = (name) => getComputedStyle(figure).getPropertyValue(name).trim();

  const draw = () => {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth * ratio, canvas.clientHeight * ratio];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    context.clearRect(0, 0, width, height);
    const scale = 0.46 * Math.min(width / reach[0], height / reach[1]) * view.zoom;
    const [middleX, middleY] = [width / 2 + view.shift[0] * ratio, height / 2 + view.shift[1] * ratio];
    const [cosYaw, sinYaw] = [Math.cos(view.yaw), Math.sin(view.yaw)];
    const [cosPitch, sinPitch] = [Math.cos(view.pitch), Math.sin(view.pitch)];
    // z is up; a pitch of 90° looks from above.
    const project = (list, i) => {
      const [x, y, z] = [list[i], list[i + 1], list[i + 2]];
      const along = cosYaw * x - sinYaw * y;
      const away = sinYaw * x + cosYaw * y;
      return [middleX + scale * along, middleY - scale * (sinPitch * away + cosPitch * z)];
    };
    const size = Math.max(1, 1.4 * ratio);
    for (let shade = 0; shade < shades; shade++) {
      context.fillStyle = color("--shade" + shade);
      for (let i = 0; i < data.cloud.length; i += 3) {
        const share = (data.cloud[i + 2] - low) / Math.max(1, high - low);
        if (Math.min(shades - 1, Math.floor(share * shades)) !== shade) continue;
        const [x, y] = project(data.cloud, i);
        context.fillRect(x, y, size, size);
      }
    }
    for (const path of data.paths) {
      context.strokeStyle = path.truth ? color("--ink") : color("--track" + path.ink);
      context.lineWidth = (path.truth ? 1 : 2.2) * ratio;
      context.setLineDash(path.truth ? [6 * ratio, 4 * ratio] : []);
      for (const piece of path.pieces) {
        context.beginPath();
        for (let i = 0; i < piece.length; i += 3) context.lineTo(...project(piece, i));
        context.stroke();
      }
      if (path.truth || path.pieces.length === 0) continue;
      context.fillStyle = context.strokeStyle;
      context.beginPath();
      context.arc(...project(path.pieces[0], 0), 5 * ratio, 0, 2 * Math.PI);
      context.fill();
    }
    context.setLineDash([]);
    bar(width, height, scale, ratio);
  };
  // How long a metre is, or as many as are easily seen.
  const bar = (width, height, scale, ratio) => {
    const most = 0.25 * width * data.step / scale;
    const power = 10 ** Math.floor(Math.log10(most));
    const metres = power * [5, 2, 1].find((f) => f * power <= most);
    const length = metres / data.step * scale;
    context.strokeStyle = context.fillStyle = color("--muted");
    context.lineWidth = ratio;
    context.beginPath();
    context.moveTo(12 * ratio, height - 12 * ratio);
    context.lineTo(12 * ratio + length, height - 12 * ratio);
    context.stroke();
    context.font = `${13 * ratio}px sans-serif`;
    context.fillText(Number(metres.toPrecision(1)) + " m", 12 * ratio, height - 18 * ratio);
  };

  const pointers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, event);
  });
  const end = (event) => pointers.delete(event.pointerId);
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
    if (pointers.size > 1) {
      const other = [...pointers.values()].find((p) => p.pointerId !== event.pointerId);
      const distance = (p) => Math.hypot(p.clientX - other.clientX, p.clientY - other.clientY);
      view.zoom *= Math.max(0.5, Math.min(2, distance(event) / Math.max(1, distance(before))));
    }
    if (event.shiftKey || pointers.size > 1) {
      view.shift = [view.shift[0] + dx / pointers.size, view.shift[1] + dy / pointers.size];
    } else {
      view.yaw += dx * 0.008;
      view.pitch = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, view.pitch + dy * 0.008));
    }
    pointers.set(event.pointerId, event);
    requestAnimationFrame(draw);
  });
  canvas.addEventListener("wheel", (event) => {
    // Without Ctrl the wheel scrolls the page.
    if (!event.ctrlKey) return;
    event.preventDefault();
    view.zoom = Math.max(0.2, Math.min(100, view.zoom * Math.exp(-event.deltaY * 0.002)));
    requestAnimationFrame(draw);
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const step = 0.1;
    if (event.key === "ArrowLeft") view.yaw -= step;
    else if (event.key === "ArrowRight") view.yaw += step;
    else if (event.key === "ArrowUp") view.pitch = Math.min(Math.PI / 2, view.pitch + step);
    else if (event.key === "ArrowDown") view.pitch = Math.max(-Math.PI / 2, view.pitch - step);
    else if (event.key === "+") view.zoom *= 1.2;
    else if (event.key === "-") view.zoom /= 1.2;
    else return;
    event.preventDefault();
    requestAnimationFrame(draw);
  });
  canvas.addEventListener("dblclick", () => {
    view = structuredClone(start);
    draw();
  });
  new ResizeObserver(draw).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
}
