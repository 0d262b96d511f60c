// Results of one recording: its model with texts and figures, and its report.

import { ask, askJson, byId, make, notice } from "./elements.js";
import { save } from "./picture.js";

// `simulated` is called with the model's name, and its simulated curves by signal.
export async function identify(file, output, simulated) {
  const where = byId("model"); // element of this recording; the next recording has another element
  try {
    const found = await askJson("identify", { file, output });
    if (!where.isConnected) return;
    showModel(where, found);
    await simulated(found.model, found.simulated);
  } catch (error) {
    // The data are plotted above, whether a model fits or not.
    where.replaceChildren(make("p", { className: "bad-text", role: "alert", textContent: `no model: ${error.message}` }));
  }
  where.scrollIntoView({ block: "start" });
}

// Save the report of the models of an output as a PDF, and show its name.
export async function report(file, output) {
  const where = byId("reported");
  const name = file.replace(/mcap$/, "pdf");
  try {
    const pdf = await (await ask("report", { file, output })).blob();
    save(pdf, name);
    notice(""); // the result names the file
    where.replaceChildren(make("p", { className: "answer", textContent: `${name}: ${Math.ceil(pdf.size / 1000)} kB, saved by this browser` }));
  } catch (error) {
    where.replaceChildren(make("p", { className: "bad-text", role: "alert", textContent: `no report: ${error.message}` }));
  }
  where.scrollIntoView({ block: "center" });
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
  where.replaceChildren(make("p", { className: "answer", textContent: found.answer }), make("h2", { textContent: `${found.model}, judged on ${found.judged}` }), ...texts, make("div", { className: "figures" }, ...figures));
}
