// Presentation of the signals that the server describes: their axes, decimals and colours.

const [LIVE_STEPS, RECORDED_STEPS] = [11, 3]; // least range of an axis, in steps of the converter

// Return the signals of a rig for live plots, or for the plots of a recording.
export function presented(signals, isRecorded = false) {
  return signals.map((given) => ({ ...given, name: nameOf(given, isRecorded), colour: colourOf(given), ...axisOf(given, isRecorded) }));
}

function nameOf({ label, kind, per_volt }, isRecorded) {
  if (per_volt) return `${label} (${per_volt.join(" ")} per V)`;
  return isRecorded && kind === "turning" ? `${label}, turns counted` : label;
}

function colourOf({ kind, channel = 0 }) {
  if (kind === "input") return "u";
  return kind === "rate" ? "rate" : channel ? "second" : "first";
}

function axisOf({ kind, step, is_symmetric }, isRecorded) {
  const digits = Math.max(0, Math.ceil(-Math.log10(step))); // show a step of the converter
  if (kind === "input") return { range: [0, 5], pad: 0.3, digits: isRecorded ? 3 : 2, splits: [0, 1, 2, 3, 4, 5], fewSplits: [0, 2.5, 5] };
  if (isRecorded) return { range: null, least: RECORDED_STEPS * step, digits: kind === "rate" ? digits : digits + 1 };
  if (kind === "turning") return { range: [0, 360], pad: 10, digits, splits: [0, 90, 180, 270, 360], fewSplits: [0, 180, 360], wraps: true };
  return { range: null, least: LIVE_STEPS * step, digits, isSymmetric: is_symmetric, isRate: kind === "rate" };
}

// Return the outputs among the signals, in the order of the rig's channels.
export const outputsOf = (signals) => signals.filter(({ kind }) => ["value", "turning"].includes(kind));

// Return the least and the largest value as text; "" if they are not known.
export function valueText({ digits, unit, per_volt }, least, largest) {
  if (Number.isNaN(least)) return "";
  const text = (show) => (least === largest ? show(least) : `${show(least)} … ${show(largest)}`);
  const volts = `${text((x) => x.toFixed(digits))} ${unit}`;
  return per_volt ? `${volts}, ${text((x) => String(+(per_volt[0] * x).toPrecision(3)))} ${per_volt[1]}` : volts;
}
