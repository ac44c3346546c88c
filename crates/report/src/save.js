// Each drawing as a file of its own: SVG for papers, PNG for slides. Colours are those of the page as it is seen.
{
  const saved = (blob, name) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = name;
    link.click();
    // The download has begun by then, also in browsers that ask first.
    setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
  };
  const named = (drawing, ending) => {
    const title = drawing.closest("section, figure")?.querySelector("h2, h3")?.textContent;
    const words = (drawing.getAttribute("aria-label") ?? title ?? document.title).match(/[\p{L}\p{N}]+/gu);
    return (words ?? ["drawing"]).join("-").toLowerCase().slice(0, 80) + ending;
  };
  // The drawing without the page around it: variables of the style sheet become colours, and fonts those that are drawn with here.
  const alone = (svg) => {
    const copy = svg.cloneNode(true);
    const style = getComputedStyle(svg);
    const view = svg.viewBox.baseVal;
    const width = 1200;
    copy.setAttribute("width", width);
    copy.setAttribute("height", Math.round(width * view.height / view.width));
    copy.setAttribute("font-family", style.fontFamily);
    copy.querySelectorAll(".selection").forEach((selection) => selection.remove());
    const paper = document.createElementNS(svg.namespaceURI, "rect");
    for (const [name, value] of [["x", view.x], ["y", view.y], ["width", view.width], ["height", view.height], ["fill", "var(--page)"]]) {
      paper.setAttribute(name, value);
    }
    copy.prepend(paper);
    const text = new XMLSerializer().serializeToString(copy);
    return text.replace(/var\((--[a-z0-9-]+)\)/g, (_, name) => style.getPropertyValue(name).trim());
  };
  // A canvas is clear where nothing is drawn: on white slides a dark page's lines would be lost.
  const onPaper = (drawing, width, height, draw) => {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [width, height];
    const context = canvas.getContext("2d");
    context.fillStyle = getComputedStyle(drawing).getPropertyValue("--page").trim();
    context.fillRect(0, 0, width, height);
    draw(context);
    return canvas;
  };
  const raster = async (svg) => {
    const image = new Image();
    image.src = "data:image/svg+xml;charset=utf-8," + encodeURIComponent(alone(svg));
    await image.decode();
    const [width, height] = [2 * image.width, 2 * image.height];
    return onPaper(svg, width, height, (context) => context.drawImage(image, 0, 0, width, height));
  };
  const png = (drawing, canvas) => canvas.toBlob((blob) => saved(blob, named(drawing, ".png")), "image/png");

  for (const drawing of document.querySelectorAll("figure svg, .plot svg, figure.scene canvas")) {
    const box = drawing.closest(".plot") ?? drawing.parentElement;
    const buttons = document.createElement("div");
    buttons.className = "save";
    const offer = (label, action) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = label;
      button.title = "Save this drawing as " + label;
      button.addEventListener("click", action);
      buttons.append(button);
    };
    if (drawing instanceof SVGElement) {
      offer("SVG", () => saved(new Blob([alone(drawing)], { type: "image/svg+xml" }), named(drawing, ".svg")));
      offer("PNG", async () => png(drawing, await raster(drawing)));
    } else {
      offer("PNG", () => png(drawing, onPaper(drawing, drawing.width, drawing.height, (context) => context.drawImage(drawing, 0, 0))));
    }
    box.classList.add("saveable");
    box.append(buttons);
  }
}
