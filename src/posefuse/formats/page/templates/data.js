"use strict";
// the data of the page: base64 of gzip, see files of the same names in the package posefuse
const inflated = async id => {
  const bytes = Uint8Array.from(atob(document.getElementById(id).textContent.trim()), c => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
};
const pageData = inflated("page-data").then(JSON.parse);
const colour = name => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
// what is folded away is there on paper
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach(one => { one.open = true; }));
const dark = matchMedia("(prefers-color-scheme: dark)");
const faded = (hex, alpha) => {
  const long = hex.length === 4 ? [...hex.slice(1)].map(c => c + c).join("") : hex.slice(1);
  return `rgba(${[0, 2, 4].map(i => parseInt(long.slice(i, i + 2), 16)).join(",")},${alpha})`;
};
