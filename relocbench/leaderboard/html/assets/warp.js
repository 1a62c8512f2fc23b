/* Warping a keyframe into a query by its inverse depth, and comparing the two. Images are ImageData, pixels have their
   centres at integers, a camera is [width, height, fx, fy, cx, cy], a pose the upper three rows of T_query_ref. */
"use strict";

relocbench.warp = (() => {
  const FAR_APART = 0.2; // neighbours whose inverse depths differ by more are of different surfaces
  const LARGEST = 8; // pixels of the query that one pixel of the keyframe covers at most, each way

  /** Inverse depth (1/m) at every pixel of the keyframe, 0 where unknown: interpolated within a surface only. */
  function dense(depth, width, height) {
    const raw = relocbench.bytes(depth.data), view = new DataView(raw.buffer);
    const { rows, columns, step, unit } = depth;
    const node = (i, j) => view.getUint16(2 * (i * columns + j), true) * unit;
    const out = new Float32Array(width * height);
    for (let v = 0; v < height; v++) {
      const y = Math.min(Math.max((v - (step - 1) / 2) / step, 0), rows - 1), i = Math.min(Math.floor(y), Math.max(rows - 2, 0));
      for (let u = 0; u < width; u++) {
        const x = Math.min(Math.max((u - (step - 1) / 2) / step, 0), columns - 1), j = Math.min(Math.floor(x), Math.max(columns - 2, 0));
        let sum = 0, weights = 0, least = Infinity, most = 0, nearest = 0, heaviest = -1;
        for (let a = 0; a < 2; a++) {
          for (let b = 0; b < 2; b++) {
            if (i + a >= rows || j + b >= columns) continue;
            const value = node(i + a, j + b);
            if (!value) continue;
            const weight = (1 - Math.abs(y - i - a)) * (1 - Math.abs(x - j - b));
            sum += weight * value;
            weights += weight;
            least = Math.min(least, value);
            most = Math.max(most, value);
            if (weight > heaviest) { heaviest = weight; nearest = value; }
          }
        }
        if (heaviest <= 0) continue;
        out[v * width + u] = most - least > FAR_APART * most ? nearest : sum / weights;
      }
    }
    return out;
  }

  /** Inverse depth of the keyframe's surfaces at every pixel of the query, the nearest surface in front. */
  function seen(inverse, from, to, pose) {
    const [width, height, fx, fy, cx, cy] = from, [outWidth, outHeight, gx, gy, hx, hy] = to;
    const buffer = new Float32Array(outWidth * outHeight);
    for (let v = 0, at = 0; v < height; v++) {
      const y = (v - cy) / fy;
      for (let u = 0; u < width; u++, at++) {
        const rho = inverse[at];
        if (!rho) continue;
        const x = (u - cx) / fx;
        const pz = pose[8] * x + pose[9] * y + pose[10] + pose[11] * rho;
        if (pz <= 1e-3) continue;
        const s = (gx * (pose[0] * x + pose[1] * y + pose[2] + pose[3] * rho)) / pz + hx;
        const t = (gy * (pose[4] * x + pose[5] * y + pose[6] + pose[7] * rho)) / pz + hy;
        const size = Math.min(LARGEST, Math.max(1, Math.ceil(gx / (fx * pz)))) + 1; // no holes between neighbours
        const left = Math.ceil(s - size / 2), top = Math.ceil(t - size / 2), value = rho / pz;
        for (let b = Math.max(top, 0); b < Math.min(top + size, outHeight); b++) {
          for (let a = Math.max(left, 0); a < Math.min(left + size, outWidth); a++) {
            const place = b * outWidth + a;
            if (value > buffer[place]) buffer[place] = value;
          }
        }
      }
    }
    return filled(buffer, outWidth, outHeight);
  }

  /** The same without gaps of one or two pixels, which open where a slanted surface is stretched. */
  function filled(buffer, width, height) {
    const out = buffer.slice();
    const between = (at, before, after, stride) => {
      for (let a = 1; a <= Math.min(2, before); a++) {
        for (let b = 1; b <= Math.min(3 - a, after); b++) {
          const first = buffer[at - a * stride], second = buffer[at + b * stride];
          if (first && second && Math.abs(first - second) <= FAR_APART * Math.max(first, second)) return (first * b + second * a) / (a + b);
        }
      }
      return 0;
    };
    for (let v = 0, at = 0; v < height; v++) {
      for (let u = 0; u < width; u++, at++) {
        if (!buffer[at]) out[at] = between(at, v, height - 1 - v, width) || between(at, u, width - 1 - u, 1);
      }
    }
    return out;
  }

  /** The keyframe as the query's camera would see it at a pose; transparent where it shows nothing. */
  function warp(image, inverse, from, to, pose) {
    const [width, height, fx, fy, cx, cy] = from, [outWidth, outHeight, gx, gy, hx, hy] = to;
    const buffer = seen(inverse, from, to, pose), out = new ImageData(outWidth, outHeight);
    const source = image.data, target = out.data;
    for (let t = 0, at = 0; t < outHeight; t++) {
      for (let s = 0; s < outWidth; s++, at++) {
        const q = buffer[at];
        if (!q) continue;
        const x = (s - hx) / gx - pose[3] * q, y = (t - hy) / gy - pose[7] * q, z = 1 - pose[11] * q;
        const pz = pose[2] * x + pose[6] * y + pose[10] * z; // R^T (ray - t q)
        if (pz <= 1e-6) continue;
        const u = (fx * (pose[0] * x + pose[4] * y + pose[8] * z)) / pz + cx;
        const v = (fy * (pose[1] * x + pose[5] * y + pose[9] * z)) / pz + cy;
        if (u < -0.5 || v < -0.5 || u > width - 0.5 || v > height - 0.5) continue;
        const i = Math.min(Math.max(Math.floor(v), 0), Math.max(height - 2, 0)), j = Math.min(Math.max(Math.floor(u), 0), Math.max(width - 2, 0));
        const down = Math.min(Math.max(v - i, 0), 1), right = Math.min(Math.max(u - j, 0), 1);
        const first = 4 * (i * width + j), second = first + 4 * width;
        if (!(source[first + 3] && source[first + 7] && source[second + 3] && source[second + 7])) continue;
        for (let c = 0; c < 3; c++) {
          const above = source[first + c] * (1 - right) + source[first + 4 + c] * right;
          const below = source[second + c] * (1 - right) + source[second + 4 + c] * right;
          target[4 * at + c] = above * (1 - down) + below * down;
        }
        target[4 * at + 3] = 255;
      }
    }
    return out;
  }

  const hatch = (i, width) => ((Math.floor(i / width) + (i % width)) % 8 < 2 ? 110 : 80);
  const grey = (data, at) => 0.299 * data[at] + 0.587 * data[at + 1] + 0.114 * data[at + 2];

  /** The difference as a picture, the correlation of grey values where both show something, and the share that do. */
  function compare(warped, query) {
    const a = warped.data, b = query.data, pixels = a.length / 4;
    let n = 0, sa = 0, sb = 0, saa = 0, sbb = 0, sab = 0;
    for (let i = 0; i < pixels; i++) {
      if (!a[4 * i + 3] || !b[4 * i + 3]) continue;
      const p = grey(a, 4 * i), q = grey(b, 4 * i);
      n++; sa += p; sb += q; saa += p * p; sbb += q * q; sab += p * q;
    }
    const va = n ? saa / n - (sa / n) ** 2 : 0, vb = n ? sbb / n - (sb / n) ** 2 : 0;
    const correlation = va > 1e-9 && vb > 1e-9 ? (sab / n - (sa / n) * (sb / n)) / Math.sqrt(va * vb) : NaN;
    const gain = va > 1e-9 ? Math.sqrt(vb / va) : 1, scale = vb > 1e-9 ? 85 / Math.sqrt(vb) : 1;
    const picture = new ImageData(warped.width, warped.height), c = picture.data;
    for (let i = 0; i < pixels; i++) {
      const shown = a[4 * i + 3] > 0 && b[4 * i + 3] > 0;
      const value = shown ? scale * Math.abs(gain * (grey(a, 4 * i) - sa / n) - (grey(b, 4 * i) - sb / n)) : hatch(i, warped.width);
      c[4 * i] = c[4 * i + 1] = value;
      c[4 * i + 2] = shown ? value : value + 25;
      c[4 * i + 3] = 255;
    }
    return { picture, correlation, share: n / pixels };
  }

  /** The warped keyframe with hatching where it shows nothing, so that the query below does not pass for it. */
  function hatched(warped) {
    const out = new ImageData(new Uint8ClampedArray(warped.data), warped.width, warped.height);
    for (let i = 0; i < out.data.length / 4; i++) {
      if (out.data[4 * i + 3]) continue;
      const value = hatch(i, warped.width);
      out.data.set([value, value, value + 25, 255], 4 * i);
    }
    return out;
  }

  return { dense, warp, compare, hatched };
})();
