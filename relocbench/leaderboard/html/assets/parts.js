/* What the charts of a set's page share that stand in scripts of their own. Each puts a function into relocbench.parts, which
   the page calls with what is chosen after each change. */
"use strict";

relocbench.parts = [];

/** At most `most` of some items, evenly taken from their order. */
relocbench.evenly = (items, most) => {
  const count = Math.min(items.length, most);
  return Array.from({ length: count }, (_, i) => items[Math.floor((i * items.length) / count)]);
};

/** What stands beside a point that is a pair. */
relocbench.pairText = (pair) => {
  const { escape, number } = relocbench;
  const error = pair.status === "ok" ? `${number(pair.t, "m")} m, ${number(pair.r, "deg")}°` : relocbench.STATUS[pair.status];
  return `${error}<br>${escape(pair.set)}<br>${number(pair.distance, "m")} m and ${number(pair.angle, "deg")}° from the keyframe`;
};

/** A click on a point opens its pair; with a key for new tabs, in one. */
relocbench.openPair = (address, event) => {
  if (event?.ctrlKey || event?.metaKey) window.open(address);
  else location.href = address;
};
