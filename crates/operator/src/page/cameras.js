// Small pictures of what the cameras see.

const KIND = 2;
const HEAD_BYTES = 6;
const STALE_MS = 4000;

export class Cameras {
  constructor(list) {
    this.list = list;
    this.clear();
  }

  clear() {
    this.views = new Map();
    this.list.replaceChildren();
  }

  /// Takes a picture, laid out as in preview.rs; false where the message is none.
  take(buffer) {
    const data = new DataView(buffer);
    if (data.byteLength < HEAD_BYTES || data.getUint8(0) !== KIND) return false;
    const nameBytes = data.getUint8(1);
    const [width, height] = [data.getUint16(2, true), data.getUint16(4, true)];
    const name = new TextDecoder().decode(new Uint8Array(buffer, HEAD_BYTES, nameBytes));
    const grey = new Uint8Array(buffer, HEAD_BYTES + nameBytes);
    if (grey.length < width * height) return true;
    const view = this.view(name);
    view.canvas.width = width;
    view.canvas.height = height;
    const image = view.context.createImageData(width, height);
    for (let i = 0; i < width * height; i++) {
      image.data.fill(grey[i], 4 * i, 4 * i + 3);
      image.data[4 * i + 3] = 255;
    }
    view.context.putImageData(image, 0, 0);
    view.heard = performance.now();
    this.age();
    return true;
  }

  view(name) {
    let view = this.views.get(name);
    if (!view) {
      const figure = document.createElement("figure");
      const canvas = document.createElement("canvas");
      const words = document.createElement("figcaption");
      figure.append(canvas, words);
      this.list.append(figure);
      view = { name, figure, words, canvas, context: canvas.getContext("2d"), heard: 0 };
      this.views.set(name, view);
    }
    return view;
  }

  /// Says which pictures are old: a still picture looks like a camera that works.
  age() {
    const now = performance.now();
    for (const { name, figure, words, heard } of this.views.values()) {
      const stale = now - heard > STALE_MS;
      figure.dataset.stale = String(stale);
      words.textContent = stale ? `${name}: ${Math.round((now - heard) / 1000)} s old` : name;
    }
  }
}
