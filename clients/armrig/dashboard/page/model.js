// Model of one recording: its texts and figures.

import { askJson, byId, make } from "./elements.js";

// `simulated` is called with the model's name, its output signal, and its simulated curve.
export async function identify(file, output, simulated) {
  const where = byId("model"); // element of this recording; the next recording has another element
  where.replaceChildren(make("p", { textContent: "estimating …", role: "status" }));
  try {
    const found = await askJson("identify", { file, output });
    showModel(where, found);
    simulated(found.model, ...found.simulated);
  } catch (error) {
    // The data are plotted above, whether a model fits or not.
    where.replaceChildren(make("p", { className: "bad-text", role: "alert", textContent: `no model: ${error.message}` }));
  }
}

function showModel(where, found) {
  const figures = found.figures.map(([title, svg]) => {
    const url = URL.createObjectURL(new Blob([svg], { type: "image/svg+xml" }));
    const image = make("img", { src: url, alt: title });
    image.addEventListener("load", () => URL.revokeObjectURL(url));
    return make("figure", {}, make("figcaption", { textContent: title }), image);
  });
  const texts = found.texts.map(([title, text], i) => {
    const part = make("details", { open: i === 0 || title === "advice" }, make("summary", { textContent: title }), make("pre", { textContent: text }));
    return part;
  });
  where.replaceChildren(make("h2", { textContent: `${found.model}, judged on ${found.judged}` }), ...texts, make("div", { className: "figures" }, ...figures));
}
