/* The matches that a method tells of a pair: lines from the keyframe to the query beside it. */
"use strict";

/**
 * Draw matches [[u, v, u', v', agrees]] between two small pictures ({src, camera}).
 * Those that agree with the answer are full lines on top, others are dashed.
 */
relocbench.drawMatches = (node, reference, query, matches, words) => {
  const [width, height] = reference.camera, [across, down] = query.camera, gap = 8;
  const total = [width + gap + across, Math.max(height, down)];
  const draw = relocbench.svg, svg = draw("svg", { viewBox: `0 0 ${total[0]} ${total[1]}`, role: "img", "aria-label": words });
  svg.append(draw("image", { href: reference.src, width, height }), draw("image", { href: query.src, x: width + gap, width: across, height: down }));
  for (const [u, v, x, y, agrees] of [...matches].sort((a, b) => a[4] - b[4])) {
    const line = { x1: u, y1: v, x2: x + width + gap, y2: y };
    const look = agrees ? { stroke: "#4fd1ff", "stroke-width": 1.2 } : { stroke: "#ffb000", "stroke-width": 1, "stroke-dasharray": "4 3", opacity: 0.8 };
    svg.append(draw("line", { ...line, ...look }));
    for (const [cx, cy] of [[line.x1, line.y1], [line.x2, line.y2]]) svg.append(draw("circle", { cx, cy, r: 2, fill: look.stroke }));
  }
  node.replaceChildren(svg);
};
