"use strict";
document.querySelectorAll("table.sortable").forEach((node) => relocbench.table(node, {}, node.id));
