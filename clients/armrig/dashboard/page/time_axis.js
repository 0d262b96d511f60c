// What the time axis counts: seconds from now, the time of day, or seconds since a run began.

export const AXES = ["from now", "clock", "since start"];

// Where an axis begins to count, whose 0 was at `zero` in the samples' time and at `shown` in ms.
export function originOf(axis, zero, shown, marks) {
  if (axis === "clock") return { s: shown / 1000, isClock: true };
  const start = marks.findLast(({ kind }) => kind === "start");
  return { s: axis === "since start" && start ? zero - start.t : 0 };
}
