"use strict";
// Where labels stand beside their marks: never over another label, over as few marks as can be.
(() => {
  const HIGH = 15, CLEAR = 7, BESIDE = 11;

  // Of `labels` ({x, y, width} of the mark and its text, px) those that find room in `box`
  // ({l, r, t, b}), each with {left, middle} of its text; `marks`: [x, y] of all marks. `reach`: the
  // farthest that a text stands above or below its mark. The pointer still tells what is left out.
  window.placedLabels = (labels, marks, box, reach = 60) => {
    const heights = [0];
    for (let up = HIGH; up <= reach; up += HIGH) heights.push(-up, up);
    const taken = [], found = [];
    for (const label of labels) {
      const { x, y, width } = label;
      const free = (left, middle) =>
        left > box.l + 2 && left + width < box.r - 2 && middle > box.t + 8 && middle < box.b - 8 &&
        taken.every(([from, at, to]) => left + width < from || left > to || Math.abs(middle - at) > HIGH);
      const covered = (left, middle) => marks.filter(([p, q]) =>
        p > left - CLEAR && p < left + width + CLEAR && Math.abs(q - middle) < CLEAR + HIGH / 2 - 2 &&
        !(p === x && q === y)).length;
      let best = null, least = Infinity;
      for (const up of heights)
        for (const left of [x + BESIDE, x - BESIDE - width]) {
          if (!free(left, y + up)) continue;
          const cost = 3 * covered(left, y + up) + Math.abs(up) / HIGH;
          if (cost < least) { least = cost; best = { ...label, left, middle: y + up }; }
        }
      if (!best) continue;
      taken.push([best.left - 3, best.middle, best.left + width + 3]);
      found.push(best);
    }
    return found;
  };
})();
