"use strict";
// Where things lie on the canvas: the field's square, or metres round an origin; and the layers that are drawn there.

/** From the world to the canvas, in CSS pixels. `x` and `y` are for a context that has been turned. */
class Projection {
  /** `bounds` is [west, south, east, north] in the world's unit, `box` is [x, y, width, height], `angle` is by how
      much the world is turned in the box, in degrees clockwise. */
  constructor(bounds, box, angle = 0) {
    const [west, south, east, north] = bounds;
    const [x, y, width, height] = box;
    this.bounds = bounds;
    this.angle = angle;
    this.centre = [x + width / 2, y + height / 2];
    const [cos, sin] = [Math.cos, Math.sin].map((of) => Math.abs(of((angle * Math.PI) / 180)));
    const [wide, high] = [east - west, north - south];
    const across = [wide * cos + high * sin, wide * sin + high * cos];
    this.scale = Math.min(width / across[0], height / across[1]);
    /** Half the width and the height of what is drawn. */
    this.reach = across.map((length) => (this.scale * length) / 2);
    this.left = x + (width - this.scale * wide) / 2 - this.scale * west;
    this.base = y + (height + this.scale * high) / 2 + this.scale * south;
  }

  /** Turns what is drawn from now on. */
  turn(context) {
    if (this.angle === 0) return;
    context.translate(...this.centre);
    context.rotate((this.angle * Math.PI) / 180);
    context.translate(-this.centre[0], -this.centre[1]);
  }

  x(east) {
    return this.left + this.scale * east;
  }

  y(north) {
    return this.base - this.scale * north;
  }
}

/** An offscreen layer that is painted again only when its key changes. */
class Layer {
  constructor() {
    this.canvas = document.createElement("canvas");
    this.key = "";
  }

  /** A cleared context if the layer is out of date, else null. */
  begin(key, width, height, ratio) {
    const full = `${key}|${width}x${height}@${ratio}`;
    if (full === this.key) return null;
    this.key = full;
    const size = [Math.round(width * ratio), Math.round(height * ratio)];
    const context = this.canvas.getContext("2d");
    // A canvas of the same size is wiped; to give it a size anew costs more.
    if (this.canvas.width !== size[0] || this.canvas.height !== size[1]) [this.canvas.width, this.canvas.height] = size;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, ...size);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.lineJoin = "round";
    context.lineCap = "round";
    return context;
  }
}

const EARTH_RADIUS_M = 6_378_137;

/** [latitude, longitude] in degrees to [east, north] in metres round `origin`; for fields of a few km. */
function metresFromDegrees([latitude, longitude], origin) {
  const radians = Math.PI / 180;
  return [
    (longitude - origin[1]) * radians * EARTH_RADIUS_M * Math.cos(origin[0] * radians),
    (latitude - origin[0]) * radians * EARTH_RADIUS_M,
  ];
}

/** Metres east and north to metres along the right and the up of a frame whose up is `heading` degrees from north. */
function turned([east, north], heading) {
  const [sin, cos] = [Math.sin((heading * Math.PI) / 180), Math.cos((heading * Math.PI) / 180)];
  return [cos * east - sin * north, cos * north + sin * east];
}

/** All polygons of a GeoJSON object, each a list of rings, in metres of the frame that a `geo` line tells. */
function polygonsOf(geojson, { origin, heading = 0 }) {
  const found = [];
  const walk = (node) => {
    if (!node) return;
    for (const feature of node.features ?? []) walk(feature.geometry);
    for (const geometry of node.geometries ?? []) walk(geometry);
    if (node.geometry) walk(node.geometry);
    const polygons = { Polygon: [node.coordinates], MultiPolygon: node.coordinates }[node.type] ?? [];
    const place = ([longitude, latitude]) => turned(metresFromDegrees([latitude, longitude], origin), heading);
    for (const polygon of polygons) found.push(polygon.map((ring) => ring.map(place)));
  };
  walk(geojson);
  return found;
}

/** The largest of 1, 2 and 5 times a power of ten that is no more than `value`. */
function niceBelow(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [5, 2, 1].map((digit) => digit * power).find((nice) => nice <= value * (1 + 1e-9)) ?? power;
}

/** Bounds of a local map: the flights and the scenario's places, with room about them, and more where there are
    buildings to be seen. */
function localBounds(store) {
  const { start, goal, channel } = store.scenario;
  [start, goal, channel?.base_station].forEach((place) => store.include(place));
  const [west, south, east, north] = store.extent;
  if (west > east) return [-50, -50, 50, 50];
  // Never less than this across; rounded, so that a flight does not shake the map.
  const least = store.buildings.length > 0 ? 150 : 20;
  const span = Math.max(east - west, north - south);
  const step = niceBelow(Math.max(span, least) / 4);
  const grow = step / 2 + Math.max(0, least - span) / 2;
  return [
    Math.floor((west - grow) / step) * step,
    Math.floor((south - grow) / step) * step,
    Math.ceil((east + grow) / step) * step,
    Math.ceil((north + grow) / step) * step,
  ];
}

/** Line segments [x0, y0, x1, y1] where the row-by-row grid of n*n values crosses `level`, in cells. */
function contour(values, n, level) {
  const segments = [];
  const cut = (a, b) => (level - a) / (b - a);
  for (let row = 0; row + 1 < n; row += 1) {
    for (let column = 0; column + 1 < n; column += 1) {
      const at = row * n + column;
      const [sw, se, ne, nw] = [values[at], values[at + 1], values[at + n + 1], values[at + n]];
      const points = [];
      if (sw < level !== se < level) points.push([column + cut(sw, se), row]);
      if (se < level !== ne < level) points.push([column + 1, row + cut(se, ne)]);
      if (nw < level !== ne < level) points.push([column + cut(nw, ne), row + 1]);
      if (sw < level !== nw < level) points.push([column, row + cut(sw, nw)]);
      for (let k = 0; k + 1 < points.length; k += 2) segments.push([...points[k], ...points[k + 1]]);
    }
  }
  return segments;
}
