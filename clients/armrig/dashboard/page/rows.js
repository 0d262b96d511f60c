// The last five minutes of samples: of each bin of time the least and largest value of a signal.

const COLUMNS = 9; // t, then least and largest of each signal
const MOST = 40000; // rows
export const KEPT_S = 300;
const SILENT_S = 0.25; // without a row for so much longer than before the line breaks
const HALF_TURN = 180; // °
const WRAP_PIXELS = 2;

export class Rows {
  #values = new Float64Array(MOST * COLUMNS);
  #early = null; // what comes before the past is whole
  length = 0;

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
        if (row[0] > this.newest - KEPT_S) continue; // told already
        this.length = 0; // another clock
      }
      if (this.length === MOST) this.#forget(MOST / 4);
      const at = this.length * COLUMNS;
      for (let i = 0; i < COLUMNS; i++) this.#values[at + i] = row[i] === null ? NaN : row[i];
      this.length += 1;
    }
    if (this.length && this.newest - this.at(0, 0) > KEPT_S * 1.1) this.#forget(this.find(this.newest - KEPT_S));
  }

  at(row, column) {
    return this.#values[row * COLUMNS + column];
  }

  get newest() {
    return this.length ? this.at(this.length - 1, 0) : NaN;
  }

  // The first row at t or later.
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

  // The row that holds at t, null where there is none: before the first, and in a break.
  holding(t) {
    const row = this.find(t + 1e-9) - 1;
    if (row < 0 || (t > this.at(row, 0) + SILENT_S && this.#isBroken(row + 1, this.at(row, 0), 0))) return null;
    return row;
  }

  // Whether the line breaks before a row. Slow samples are as far apart on both sides of it.
  #isBroken(row, before, width) {
    if (row >= this.length) return false;
    const earlier = row > 1 ? this.at(row - 1, 0) - this.at(row - 2, 0) : Infinity;
    const later = row + 1 < this.length ? this.at(row + 1, 0) - this.at(row, 0) : Infinity;
    return this.at(row, 0) - before > SILENT_S + 3 * width + Math.min(earlier, later);
  }

  #forget(n) {
    this.#values.copyWithin(0, n * COLUMNS, this.length * COLUMNS);
    this.length -= n;
  }

  // x, least, largest for uPlot, about one point a pixel; null where there is a break.
  drawn(signal, { from, to, pixels, zero, wraps }) {
    const column = 1 + 2 * signal;
    const width = (to - from) / Math.max(50, pixels);
    const last = Math.min(this.length, this.find(to) + 1);
    const found = [[], [], []];
    let before = NaN; // time of the last row drawn
    let valueBefore = NaN;
    for (let i = Math.max(0, this.find(from) - 1); i < last; ) {
      const t = this.at(i, 0);
      let [least, largest] = [this.at(i, column), this.at(i, column + 1)];
      const wrapped = wraps && Math.abs(least - valueBefore) > HALF_TURN;
      if (wrapped && t < before + WRAP_PIXELS * width) {
        i += 1; // so that a gap is seen
        continue;
      }
      if (wrapped || this.#isBroken(i, before, width)) push(found, (before + t) / 2 - zero, null, null);
      for (i += 1; i < last && this.at(i, 0) < t + width; i++) {
        const [a, b] = [this.at(i, column), this.at(i, column + 1)];
        if (wraps && Math.abs(a - (Number.isNaN(largest) ? valueBefore : largest)) > HALF_TURN) break;
        if (!(least <= a)) least = Number.isNaN(a) ? least : a;
        if (!(largest >= b)) largest = Number.isNaN(b) ? largest : b;
      }
      before = this.at(i - 1, 0);
      if (!Number.isNaN(largest)) valueBefore = largest;
      push(found, t - zero, known(least), known(largest));
    }
    return found;
  }
}

function push([x, low, high], t, least, largest) {
  x.push(t);
  low.push(least);
  high.push(largest);
}

const known = (value) => (Number.isNaN(value) ? null : value);
