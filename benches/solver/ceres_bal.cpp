// Peer of `cargo run --release -p lsfb-problems --example solve -- bal`: Ceres on a file in BAL format, one thread, CPU and wall time of
// solving alone. Jacobians are analytic or automatic, as asked for.
//
//   ceres_bal FILE sparse|dense analytic|auto [covariance]
//
// With `covariance` nothing is solved: covariances are those at the values of the file.
#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <sys/resource.h>

#include <cmath>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <vector>

struct AutoProjection {
  double u, v;
  template <typename T>
  bool operator()(const T* camera, const T* point, T* r) const {
    T p[3];
    ceres::AngleAxisRotatePoint(camera, point, p);
    p[0] += camera[3];
    p[1] += camera[4];
    p[2] += camera[5];
    const T x = -p[0] / p[2], y = -p[1] / p[2];
    const T n = x * x + y * y;
    const T d = 1.0 + n * (camera[7] + camera[8] * n);
    r[0] = camera[6] * d * x - u;
    r[1] = camera[6] * d * y - v;
    return true;
  }
};

// Derivative of the rotated point by the rotation vector w: -[Rp]x Jl(w), Jl the left Jacobian of SO(3).
class AnalyticProjection : public ceres::SizedCostFunction<2, 9, 3> {
 public:
  AnalyticProjection(double u, double v) : u_(u), v_(v) {}
  bool Evaluate(double const* const* parameters, double* r, double** jacobians) const override {
    const double* c = parameters[0];
    const double* X = parameters[1];
    double R[9];  // columns first
    ceres::AngleAxisToRotationMatrix(c, R);
    double q[3], p[3];
    for (int i = 0; i < 3; ++i) {
      q[i] = R[i] * X[0] + R[3 + i] * X[1] + R[6 + i] * X[2];
      p[i] = q[i] + c[3 + i];
    }
    const double iz = 1.0 / p[2];
    const double x = -p[0] * iz, y = -p[1] * iz, n = x * x + y * y;
    const double f = c[6], k1 = c[7], k2 = c[8], d = 1.0 + n * (k1 + k2 * n);
    r[0] = f * d * x - u_;
    r[1] = f * d * y - v_;
    if (!jacobians) return true;
    const double g = f * (2.0 * k1 + 4.0 * k2 * n);
    const double a00 = f * d + g * x * x, a01 = g * x * y, a11 = f * d + g * y * y;
    double P[2][3];
    P[0][0] = -a00 * iz;
    P[0][1] = -a01 * iz;
    P[0][2] = -(a00 * x + a01 * y) * iz;
    P[1][0] = -a01 * iz;
    P[1][1] = -a11 * iz;
    P[1][2] = -(a01 * x + a11 * y) * iz;
    if (jacobians[1]) {
      for (int i = 0; i < 2; ++i)
        for (int j = 0; j < 3; ++j)
          jacobians[1][3 * i + j] = P[i][0] * R[3 * j] + P[i][1] * R[3 * j + 1] + P[i][2] * R[3 * j + 2];
    }
    if (jacobians[0]) {
      const double t2 = c[0] * c[0] + c[1] * c[1] + c[2] * c[2], t = std::sqrt(t2);
      const double A = t < 1e-4 ? 0.5 - t2 / 24 : (1 - std::cos(t)) / t2;
      const double B = t < 1e-4 ? 1.0 / 6 - t2 / 120 : (t - std::sin(t)) / (t2 * t);
      const double W[3][3] = {{0, -c[2], c[1]}, {c[2], 0, -c[0]}, {-c[1], c[0], 0}};
      double J[3][3];
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
          const double ww = W[i][0] * W[0][j] + W[i][1] * W[1][j] + W[i][2] * W[2][j];
          J[i][j] = (i == j) + A * W[i][j] + B * ww;
        }
      const double Q[3][3] = {{0, q[2], -q[1]}, {-q[2], 0, q[0]}, {q[1], -q[0], 0}};  // -[q]x
      double* o = jacobians[0];
      for (int i = 0; i < 2; ++i) {
        double pq[3];
        for (int j = 0; j < 3; ++j) pq[j] = P[i][0] * Q[0][j] + P[i][1] * Q[1][j] + P[i][2] * Q[2][j];
        for (int j = 0; j < 3; ++j) {
          o[9 * i + j] = pq[0] * J[0][j] + pq[1] * J[1][j] + pq[2] * J[2][j];
          o[9 * i + 3 + j] = P[i][j];
        }
        const double s = i == 0 ? x : y;
        o[9 * i + 6] = d * s;
        o[9 * i + 7] = f * n * s;
        o[9 * i + 8] = f * n * n * s;
      }
    }
    return true;
  }

 private:
  double u_, v_;
};

static double now(clockid_t clock) {
  timespec t;
  clock_gettime(clock, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

static double peak_mb() {
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_maxrss / 1024.0;
}

int main(int argc, char** argv) {
  if (argc < 4) return 2;
  FILE* file = std::fopen(argv[1], "r");
  if (!file) return 1;
  int nc, np, no;
  if (std::fscanf(file, "%d %d %d", &nc, &np, &no) != 3) return 1;
  std::vector<int> camera(no), point(no);
  std::vector<double> uv(2 * no), cameras(9 * nc), points(3 * np);
  for (int k = 0; k < no; ++k)
    if (std::fscanf(file, "%d %d %lf %lf", &camera[k], &point[k], &uv[2 * k], &uv[2 * k + 1]) != 4) return 1;
  for (double& x : cameras)
    if (std::fscanf(file, "%lf", &x) != 1) return 1;
  for (double& x : points)
    if (std::fscanf(file, "%lf", &x) != 1) return 1;
  std::fclose(file);

  const bool analytic = !std::strcmp(argv[3], "analytic");
  const bool covariance = argc > 4 && !std::strcmp(argv[4], "covariance");
  ceres::Problem problem;
  for (int k = 0; k < no; ++k) {
    ceres::CostFunction* cost =
        analytic ? static_cast<ceres::CostFunction*>(new AnalyticProjection(uv[2 * k], uv[2 * k + 1]))
                 : new ceres::AutoDiffCostFunction<AutoProjection, 2, 9, 3>(new AutoProjection{uv[2 * k], uv[2 * k + 1]});
    problem.AddResidualBlock(cost, nullptr, &cameras[9 * camera[k]], &points[3 * point[k]]);
  }
  ceres::Solver::Options options;
  options.linear_solver_type = std::strcmp(argv[2], "dense") ? ceres::SPARSE_SCHUR : ceres::DENSE_SCHUR;
  options.num_threads = 1;
  options.max_num_iterations = 50;
  options.function_tolerance = 1e-6;
  options.gradient_tolerance = 0;
  options.parameter_tolerance = 0;
  options.logging_type = ceres::SILENT;
  auto* ordering = new ceres::ParameterBlockOrdering;
  for (int p = 0; p < np; ++p) ordering->AddElementToGroup(&points[3 * p], 0);
  for (int c = 0; c < nc; ++c) ordering->AddElementToGroup(&cameras[9 * c], 1);
  options.linear_solver_ordering.reset(ordering);
  if (covariance) {
    // The gauge is held by the first camera's pose and the second one's z translation.
    problem.SetParameterization(&cameras[0], new ceres::SubsetParameterization(9, {0, 1, 2, 3, 4, 5}));
    problem.SetParameterization(&cameras[9], new ceres::SubsetParameterization(9, {5}));
    options.max_num_iterations = 0;
  }
  const double start = now(CLOCK_PROCESS_CPUTIME_ID), wall = now(CLOCK_MONOTONIC);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  std::printf("ceres %s %s: cost %.6f -> %.6f, %d iterations, cpu %.3f s, wall %.3f s, peak %.0f MB\n", argv[2], argv[3], summary.initial_cost,
              summary.final_cost, (int)summary.iterations.size() - 1, now(CLOCK_PROCESS_CPUTIME_ID) - start,
              now(CLOCK_MONOTONIC) - wall, peak_mb());
  if (covariance) {
    ceres::Covariance::Options how;
    how.algorithm_type = ceres::SPARSE_QR;
    ceres::Covariance estimate(how);
    const double* second = &cameras[9 * 5];
    std::vector<std::pair<const double*, const double*>> blocks = {{second, second}, {&points[3 * 100], &points[3 * 100]}};
    if (!estimate.Compute(blocks, &problem)) return 1;
    double c[81], p[9];
    estimate.GetCovarianceBlock(second, second, c);
    estimate.GetCovarianceBlock(&points[3 * 100], &points[3 * 100], p);
    std::printf("camera 5 translation, focal length, k1, k2; point 100\n");
    for (int i = 3; i < 9; ++i) {
      for (int j = 3; j < 9; ++j) std::printf("%.17e ", c[9 * i + j]);
      std::printf("\n");
    }
    for (int i = 0; i < 3; ++i) std::printf("%.17e %.17e %.17e\n", p[3 * i], p[3 * i + 1], p[3 * i + 2]);
  }
  return 0;
}
