// Signals of the live plots, in the order of a row's values, with their units and axes.

export const SIGNALS = [
  { key: "u", name: "u", unit: "V", range: [0, 5], pad: 0.3, digits: 2, splits: [0, 1, 2, 3, 4, 5], fewSplits: [0, 2.5, 5] },
  { key: "theta_1", name: "θ₁", unit: "°", range: [0, 360], pad: 10, digits: 1, splits: [0, 90, 180, 270, 360], fewSplits: [0, 180, 360], wraps: true },
  { key: "rate", name: "rate of θ₁", unit: "°/s", range: null, least: 40, digits: 0, isSymmetric: true, isRate: true },
  { key: "alpha", name: "α", unit: "°", range: null, least: 4, digits: 1, isSymmetric: true },
];

// Return the least and the largest value as text; "" if they are not known.
export function valueText({ digits, unit }, least, largest) {
  if (Number.isNaN(least)) return "";
  return least === largest ? `${least.toFixed(digits)} ${unit}` : `${least.toFixed(digits)} … ${largest.toFixed(digits)} ${unit}`;
}
