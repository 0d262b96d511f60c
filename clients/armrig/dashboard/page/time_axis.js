// Choices of the time axis: seconds from now, the time of day, or seconds since the start of a run.

export const AXES = ["from now", "clock", "since start"];

// Return the offset of an axis. The plot's 0 is at `zero` on the samples' clock, and at `shown`, in
// ms, on the browser's clock.
export function originOf(axis, zero, shown, marks) {
  if (axis === "clock") return { s: shown / 1000, isClock: true };
  const start = marks.findLast(({ kind }) => kind === "start");
  return { s: axis === "since start" && start ? zero - start.t : 0 };
}
