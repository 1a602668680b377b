"use strict";
// Turns the clouds of the page: two plots of plotly side by side, with one camera.
(() => {
  const data = JSON.parse(document.getElementById("clouds").textContent);
  const plots = ["predicted", "true"].map((name) => document.getElementById(name));
  const choice = document.getElementById("choice");
  const buttons = [...document.querySelectorAll("[data-colors]")];
  const scale = document.getElementById("scale");
  // A point is an octahedron, which smooth shading makes a ball.
  const CORNERS = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]];
  const FACES = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2],
    [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]];
  // From near to far, as the strip of the page has them.
  const SCALE = ["#4575b4", "#91bfdb", "#fee090", "#fc8d59", "#d73027"].map((c, i) => [i / 4, c]);
  const HOME = { eye: { x: 0.62, y: 0.44, z: 0.36 }, up: { x: 0, y: 0, z: 1 }, center: { x: 0, y: 0, z: 0 } };
  const shown = { index: 0, colors: "own", camera: HOME };
  let ready = null;

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

  // The library lies in the page compressed, and is unpacked when it is first needed.
  async function load() {
    const packed = bytes(document.getElementById("plotly").textContent.trim());
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
  }

  const floats = (text) => new Float32Array(bytes(text).buffer);

  // Of each vertex, six to a point.
  const repeat = (values) => Array.from(values).flatMap((value) => new Array(6).fill(value));

  function listColors(cloud, count) {
    if (shown.colors === "error" && cloud.errors) {
      const range = { cmin: 0, cmax: data.farthest, colorscale: SCALE, showscale: false };
      return { intensity: repeat(floats(cloud.errors)), ...range };
    }
    if (!cloud.colors) return { color: cloud.plain };
    const rgb = bytes(cloud.colors);
    const colors = Array.from({ length: count }, (_, n) => `rgb(${rgb.slice(3 * n, 3 * n + 3)})`);
    return { vertexcolor: repeat(colors) };
  }

  function makeBalls(cloud) {
    const points = floats(cloud.points), count = points.length / 3;
    const trace = { x: [], y: [], z: [], i: [], j: [], k: [] };
    for (let n = 0; n < count; n++) {
      for (const corner of CORNERS) {
        trace.x.push(points[3 * n] + data.radius * corner[0]);
        trace.y.push(points[3 * n + 1] + data.radius * corner[1]);
        trace.z.push(points[3 * n + 2] + data.radius * corner[2]);
      }
      for (const face of FACES) {
        trace.i.push(6 * n + face[0]);
        trace.j.push(6 * n + face[1]);
        trace.k.push(6 * n + face[2]);
      }
    }
    const lighting = { ambient: 0.55, diffuse: 0.75, specular: 0.12, roughness: 0.7, fresnel: 0.05 };
    const lightposition = { x: 300, y: -500, z: 900 };
    return { type: "mesh3d", hoverinfo: "skip", lighting, lightposition, ...listColors(cloud, count), ...trace };
  }

  function makeLayout() {
    // Fixed ranges, so that both plots and all shapes have one scale.
    const axis = { visible: false, range: [-0.8, 0.8], autorange: false };
    return {
      margin: { l: 0, r: 0, t: 0, b: 0 },
      paper_bgcolor: "rgba(0,0,0,0)",
      modebar: { bgcolor: "rgba(0,0,0,0)", color: "#8795a1", activecolor: "#2f7ebc" },
      scene: {
        xaxis: axis, yaxis: axis, zaxis: axis, aspectmode: "cube", camera: shown.camera,
        dragmode: "turntable", bgcolor: "rgba(0,0,0,0)",
      },
    };
  }

  const clouds = () => ["predicted", "true"].map((name) => data.examples[shown.index][name]);

  async function draw() {
    const config = { displaylogo: false, responsive: true, scrollZoom: true, modeBarButtons: [["toImage", "resetCameraLastSave3d"]] };
    const found = clouds();
    scale.hidden = shown.colors !== "error";
    for (const [place, plot] of plots.entries()) {
      if (!plot) continue;
      plot.parentElement.hidden = !found[place];
      if (!found[place]) continue;
      plot.querySelector(".say")?.remove();
      await Plotly.react(plot, [makeBalls(found[place])], makeLayout(), config);
      if (plot.dataset.drawn !== "yes") join(plot);
      plot.dataset.drawn = "yes";
    }
    document.body.dataset.clouds = `${shown.index} ${shown.colors}`;
  }

  // What turns one plot turns the other one.
  function join(plot) {
    const follow = (camera) => {
      if (!camera || JSON.stringify(camera) === JSON.stringify(shown.camera)) return;
      shown.camera = camera;
      for (const other of plots) {
        if (other && other !== plot && other.dataset.drawn === "yes") {
          Plotly.relayout(other, { "scene.camera": camera });
        }
      }
    };
    // A plot still glides when it says that it was let go; plotly has no event for its rest.
    const settle = (left) => {
      follow(plot._fullLayout?.scene?._scene?.getCamera());
      if (left > 0) setTimeout(settle, 100, left - 1);
    };
    plot.on("plotly_relayouting", (event) => follow(event["scene.camera"]));
    for (const ending of ["pointerup", "touchend", "wheel"]) {
      plot.addEventListener(ending, () => settle(8), { passive: true });
    }
  }

  function say(text) {
    for (const plot of plots) {
      const place = plot?.querySelector(".say");
      if (place) place.textContent = text;
    }
  }

  // One drawing after the other, whatever is clicked meanwhile.
  function show(change) {
    Object.assign(shown, change);
    choice.value = shown.index;
    for (const button of buttons) button.setAttribute("aria-pressed", button.dataset.colors === shown.colors);
    ready = (ready ?? load()).then(draw).catch((error) => {
      say("The clouds cannot be turned in this browser; the pictures below show them.");
      throw error;
    });
    return ready;
  }

  choice.addEventListener("change", () => show({ index: Number(choice.value) }));
  for (const button of buttons) {
    button.addEventListener("click", () => show({ colors: button.dataset.colors }));
  }
  // Nothing is built before the page is painted and the plots come near the window.
  new IntersectionObserver((entries, observer) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    observer.disconnect();
    requestAnimationFrame(() => setTimeout(() => show({}), 50));
  }, { rootMargin: "300px" }).observe(document.getElementById("turn"));
})();
