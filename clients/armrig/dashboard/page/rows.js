// Samples of the last five minutes, as bins of time with the least and largest value of each signal.

const MOST = 40000; // rows
export const KEPT_S = 300;
const SILENT_S = 0.25; // the line breaks if the next row is later than usual by more than this
const HALF_TURN = 180; // °
const POINTS = 4; // most points in a pixel

export class Rows {
  #columns = 0; // t, then least and largest of each signal
  #values = null;
  #early = null; // live rows that arrive before the history is complete
  length = 0;

  constructor(signals = 4) {
    this.setSignals(signals);
  }

  // Keep rows of so many signals; the present rows are discarded.
  setSignals(signals) {
    this.#columns = 1 + 2 * signals;
    this.#values = new Float64Array(MOST * this.#columns);
    this.length = 0;
  }

  begin() {
    this.length = 0;
    this.#early = [];
  }

  addLive(rows) {
    if (this.#early) this.#early.push(...rows);
    else this.add(rows);
  }

  endPast() {
    const early = this.#early ?? [];
    this.#early = null;
    this.add(early);
  }

  add(rows) {
    for (const row of rows) {
      if (this.length && row[0] <= this.newest) {
        if (row[0] > this.newest - KEPT_S) continue; // the page already has this row
        this.length = 0; // the rows are of another clock
      }
      if (this.length === MOST) this.#forget(MOST / 4);
      const at = this.length * this.#columns;
      for (let i = 0; i < this.#columns; i++) this.#values[at + i] = row[i] === null ? NaN : row[i];
      this.length += 1;
    }
    if (this.length && this.newest - this.at(0, 0) > KEPT_S * 1.1) this.#forget(this.find(this.newest - KEPT_S));
  }

  at(row, column) {
    return this.#values[row * this.#columns + column];
  }

  get newest() {
    return this.length ? this.at(this.length - 1, 0) : NaN;
  }

  // Return the number of the first row at t or later.
  find(t) {
    let low = 0;
    let high = this.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.at(middle, 0) < t) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  // Return the number of the row that is valid at t; null before the first row and in a break.
  holding(t) {
    const row = this.find(t + 1e-9) - 1;
    if (row < 0 || (t > this.at(row, 0) + SILENT_S && this.#isBroken(row + 1, this.at(row, 0), 0))) return null;
    return row;
  }

  // Return whether the line breaks before a row; it does not if the rows next to it are as far apart.
  #isBroken(row, before, width) {
    if (row >= this.length) return false;
    const earlier = row > 1 ? this.at(row - 1, 0) - this.at(row - 2, 0) : Infinity;
    const later = row + 1 < this.length ? this.at(row + 1, 0) - this.at(row, 0) : Infinity;
    return this.at(row, 0) - before > SILENT_S + 3 * width + Math.min(earlier, later);
  }

  forgetBefore(t) {
    this.#forget(this.find(t));
  }

  #forget(n) {
    this.#values.copyWithin(0, n * this.#columns, this.length * this.#columns);
    this.length -= n;
  }

  // Return x, least and largest for uPlot. Each pixel has at most four rows at their own times: the
  // first, the least, the largest and the last. The values are null where the line breaks.
  drawn(signal, { from, to, pixels, zero, wraps }) {
    const column = 1 + 2 * signal;
    const width = (to - from) / Math.max(50, pixels);
    const last = Math.min(this.length, this.find(to) + 1);
    const found = [[], [], []];
    let before = NaN; // time of the last row drawn
    let valueBefore = NaN; // the last known value
    const isWrap = (i) => wraps && Math.abs(this.at(i, column) - valueBefore) > HALF_TURN;
    for (let i = Math.max(0, this.find(from) - 1); i < last; ) {
      const t = this.at(i, 0);
      if (isWrap(i) || this.#isBroken(i, before, width)) push(found, (before + t) / 2 - zero, NaN, NaN);
      const known = [];
      let [least, largest] = [i, i];
      do {
        const [low, high] = [this.at(i, column), this.at(i, column + 1)];
        if (!Number.isNaN(low)) {
          if (!known.length || low < this.at(least, column)) least = i;
          if (!known.length || high > this.at(largest, column + 1)) largest = i;
          known.push(i);
          valueBefore = high;
        }
        i += 1;
      } while (i < last && this.at(i, 0) < t + width && !isWrap(i));
      before = this.at(i - 1, 0);
      if (!known.length) push(found, t - zero, NaN, NaN);
      const ends = new Set([known[0], Math.min(least, largest), Math.max(least, largest), known.at(-1)]);
      for (const row of known.length > POINTS ? ends : known) push(found, this.at(row, 0) - zero, this.at(row, column), this.at(row, column + 1));
    }
    return found;
  }
}

function push([x, low, high], t, least, largest) {
  x.push(t);
  low.push(Number.isNaN(least) ? null : least);
  high.push(Number.isNaN(largest) ? null : largest);
}
