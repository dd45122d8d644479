// Epipolar lines of a clicked point, lens distortion included.
(() => {
  const distort = ([x, y], [k1, k2, p1, p2, k3]) => {
    const r2 = x * x + y * y;
    const radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
    return [
      x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
      y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    ];
  };
  const normalised = (K, [u, v]) => {
    const y = (v - K[1][2]) / K[1][1];
    return [(u - K[0][2] - K[0][1] * y) / K[0][0], y];
  };
  const pixel = (K, [x, y]) => [K[0][0] * x + K[0][1] * y + K[0][2], K[1][1] * y + K[1][2]];
  const undistorted = (camera, uv) => {
    if (!camera.distortion) return uv;
    const target = normalised(camera.calibration, uv);
    let ideal = target;
    for (let step = 0; step < 30; step++) {
      const [x, y] = distort(ideal, camera.distortion);
      ideal = [ideal[0] + target[0] - x, ideal[1] + target[1] - y];
    }
    return pixel(camera.calibration, ideal);
  };
  const distorted = (camera, uv) =>
    camera.distortion
      ? pixel(camera.calibration, distort(normalised(camera.calibration, uv), camera.distortion))
      : uv;
  // The line across a picture with room to spare; what lies outside is cut by the picture.
  const across = ([a, b, c], [width, height], camera) => {
    const norm = Math.hypot(a, b);
    const [nu, nv, offset] = [a / norm, b / norm, c / norm];
    const middle = [width / 2, height / 2];
    const distance = nu * middle[0] + nv * middle[1] + offset;
    const reach = width + height;
    if (Math.abs(distance) > reach) return "";
    const foot = [middle[0] - distance * nu, middle[1] - distance * nv];
    const points = [];
    for (let t = -1; t <= 1.0001; t += 0.02) {
      const [u, v] = distorted(camera, [foot[0] - t * reach * nv, foot[1] + t * reach * nu]);
      if (u > -width && u < 2 * width && v > -height && v < 2 * height)
        points.push(`${u.toFixed(2)} ${v.toFixed(2)}`);
    }
    return points.length > 1 ? `M${points.join("L")}` : "";
  };
  document.querySelectorAll("[data-epipolar-numbers]").forEach((store) => {
    const cameras = JSON.parse(store.textContent);
    const key = store.dataset.epipolarNumbers;
    const pictures = [...document.querySelectorAll(`svg[data-epipolar="${key}"]`)];
    const show = (source, uv) => {
      const [u, v] = undistorted(cameras[source], uv);
      pictures.forEach((svg, view) => {
        svg.classList.add("has-clicked");
        const group = svg.querySelector(".clicked");
        if (view === source) {
          const radius = cameras[view].size[0] / 85;
          group.innerHTML = `<circle cx="${uv[0]}" cy="${uv[1]}" r="${radius}"/><circle cx="${uv[0]}" cy="${uv[1]}" r="${radius / 9}"/>`;
          return;
        }
        const F = cameras[source].fundamental[view];
        const line = F.map((row) => row[0] * u + row[1] * v + row[2]);
        const path = across(line, cameras[view].size, cameras[view]);
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
