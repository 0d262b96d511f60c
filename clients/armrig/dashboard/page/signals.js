// Presentation of the signals that the server describes: their axes, decimals and colours.

const [LIVE_STEPS, RECORDED_STEPS] = [11, 3]; // least range of an axis, in steps of the converter

// Return the signals of a rig for live plots, or for the plots of a recording.
export function presented(signals, isRecorded = false) {
  return signals.map((given) => ({ ...given, name: nameOf(given, isRecorded), colour: colourOf(given), ...axisOf(given, isRecorded) }));
}

function nameOf({ label, kind, own }, isRecorded) {
  if (own) return `${label} (${scaleText(own)})`;
  return isRecorded && kind === "turning" ? `${label}, turns counted` : label;
}

function colourOf({ kind, channel = 0 }) {
  if (kind === "input") return "u";
  if (kind === "reference") return "reference";
  return kind === "rate" ? "rate" : channel ? "second" : "first"; // a rotation is of the first output
}

function axisOf({ kind, step, is_symmetric, limits, span }, isRecorded) {
  const digits = Math.max(0, Math.ceil(-Math.log10(step))); // show a step of the converter
  if (kind === "input") return { range: [0, 5], pad: 0.3, digits: isRecorded ? 3 : 2, splits: [0, 1, 2, 3, 4, 5], fewSplits: [0, 2.5, 5] };
  if (kind === "reference") return { range: null, least: span / 2, digits: Math.max(0, Math.ceil(-Math.log10(span / 1000))) };
  if (kind === "turned") return { range: limits, pad: limits[1] / 5, digits, splits: [limits[0], 0, limits[1]] };
  if (isRecorded) return { range: null, least: RECORDED_STEPS * step, digits: kind === "rate" ? digits : digits + 1 };
  if (kind === "turning") return { range: [0, 360], pad: 10, digits, splits: [0, 90, 180, 270, 360], fewSplits: [0, 180, 360], wraps: true };
  return { range: null, least: LIVE_STEPS * step, digits, isSymmetric: is_symmetric, isRate: kind === "rate" };
}

// Return the signals with the reference of a run in control: in the plot of the variable that
// follows it, with the factor from its unit, or in a plot of its own below its output.
export function withReference(signals, control) {
  if (!control) return signals;
  const { name = "r", unit = "", span = 1, output, limits } = control;
  const followed = signals.find((signal) => signal.key === name && signal.unit === unit.replace("rad", "°"));
  const outputs = outputsOf(signals);
  const factor = outputs.find((signal) => signal.channel === followed?.channel)?.scale ?? 1;
  const made = signals.map((signal) => ({ ...signal, ...(signal === followed ? { factor } : {}), ...(signal.kind === "input" ? { lawLimits: limits } : {}) }));
  if (followed) return made;
  const channel = outputs.find((signal) => signal.key === output)?.channel ?? 0;
  const last = made.findLastIndex((signal) => !output || (signal.kind !== "input" && (signal.channel ?? 0) === channel));
  const label = name === "r" ? "r" : `r, ${name}`;
  return [...made.slice(0, last + 1), ...presented([{ key: "r", label, unit, kind: "reference", span }]), ...made.slice(last + 1)];
}

// Return the outputs among the signals, in the order of the rig's channels.
export const outputsOf = (signals) => signals.filter(({ kind }) => ["value", "turning"].includes(kind));

// Return the least and the largest value as text; "" if they are not known.
export function valueText({ digits, unit, own }, least, largest) {
  if (Number.isNaN(least)) return "";
  const text = (show) => (least === largest ? show(least) : `${show(least)} … ${show(largest)}`);
  const volts = `${text((x) => x.toFixed(digits))} ${unit}`;
  if (!own) return volts;
  const [per_volt, offset, ownUnit] = own;
  return `${text((x) => String(+(offset + per_volt * x).toPrecision(3)))} ${ownUnit}, ${volts} at the pin`;
}

// Return the scale of an input: its change per volt, and its value at 0 V unless this is 0.
export function scaleText([per_volt, offset, unit]) {
  return `${per_volt} ${unit} per V${offset ? `, ${offset} ${unit} at 0 V` : ""}`;
}
