// Epipolar lines of a clicked point, by any lens: its rays at a grid of pixels tell where a plane
// through both centres meets the picture.
(() => {
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const minus = (a, b) => a.map((value, axis) => value - b[axis]);
  const turned = (R, a) => R.map((row) => dot(row, a));
  const turnedBack = (R, a) => [0, 1, 2].map((axis) => R[0][axis] * a[0] + R[1][axis] * a[1] + R[2][axis] * a[2]);
  const rayAt = (camera, row, column) => {
    const at = 3 * (row * camera.places + column);
    return camera.rays.slice(at, at + 3);
  };
  const cell = (camera, value, axis) => {
    const last = camera.places - 1;
    const place = (value * last) / (camera.size[axis] - 1);
    const first = Math.min(Math.max(Math.floor(place), 0), last - 1);
    return [first, place - first];
  };
  const rayOf = (camera, [u, v]) => {
    const [column, s] = cell(camera, u, 0);
    const [row, t] = cell(camera, v, 1);
    const corners = [
      [(1 - s) * (1 - t), row, column],
      [s * (1 - t), row, column + 1],
      [(1 - s) * t, row + 1, column],
      [s * t, row + 1, column + 1],
    ];
    return corners.reduce(
      (sum, [weight, ...place]) => rayAt(camera, ...place).map((value, axis) => sum[axis] + weight * value),
      [0, 0, 0]
    );
  };
  // Where the rays are square to the normal: a stroke across each part of the grid that it meets.
  const strokes = (camera, normal) => {
    const last = camera.places - 1;
    const pixel = (row, column) =>
      `${((column * (camera.size[0] - 1)) / last).toFixed(2)} ${((row * (camera.size[1] - 1)) / last).toFixed(2)}`;
    const values = Array.from({ length: camera.places ** 2 }, (_, at) =>
      dot(normal, camera.rays.slice(3 * at, 3 * at + 3))
    );
    const paths = [];
    for (let row = 0; row < last; row += 1)
      for (let column = 0; column < last; column += 1) {
        const round = [[row, column], [row, column + 1], [row + 1, column + 1], [row + 1, column]];
        const ends = [];
        round.forEach(([r, c], side) => {
          const [r2, c2] = round[(side + 1) % 4];
          const [a, b] = [values[r * camera.places + c], values[r2 * camera.places + c2]];
          if (a < 0 === b < 0) return;
          const share = a / (a - b);
          ends.push(pixel(r + share * (r2 - r), c + share * (c2 - c)));
        });
        for (let k = 0; k + 1 < ends.length; k += 2) paths.push(`M${ends[k]}L${ends[k + 1]}`);
      }
    return paths.join("");
  };
  document.querySelectorAll("[data-epipolar-numbers]").forEach((store) => {
    const cameras = JSON.parse(store.textContent);
    const key = store.dataset.epipolarNumbers;
    const pictures = [...document.querySelectorAll(`svg[data-epipolar="${key}"]`)];
    const show = (source, uv) => {
      const from = cameras[source];
      const way = turnedBack(from.rotation, rayOf(from, uv));
      pictures.forEach((svg, view) => {
        svg.classList.add("has-clicked");
        const group = svg.querySelector(".clicked");
        if (view === source) {
          const radius = cameras[view].size[0] / 85;
          group.innerHTML = `<circle cx="${uv[0]}" cy="${uv[1]}" r="${radius}"/><circle cx="${uv[0]}" cy="${uv[1]}" r="${radius / 9}"/>`;
          return;
        }
        const camera = cameras[view];
        const normal = turned(camera.rotation, cross(minus(from.centre, camera.centre), way));
        const path = strokes(camera, normal);
        group.innerHTML = `<path class="under" d="${path}"/><path d="${path}"/>`;
      });
    };
    pictures.forEach((svg, view) => {
      svg.addEventListener("click", (event) => {
        const point = new DOMPoint(event.clientX, event.clientY);
        const { x, y } = point.matrixTransform(svg.getScreenCTM().inverse());
        show(view, [x, y]);
      });
    });
    // A click anywhere else brings the correspondences back.
    document.addEventListener("click", (event) => {
      if (event.target.closest && event.target.closest(`svg[data-epipolar="${key}"]`)) return;
      pictures.forEach((svg) => {
        svg.classList.remove("has-clicked");
        svg.querySelector(".clicked").innerHTML = "";
      });
    });
  });
})();
