// Peer of `cargo run --release --workspace --example first_equation`: Ceres on the Eq. (4) that it wrote, the format as
// `pipeline/src/mapping/first_equation.rs` has it. CPU and wall time of solving alone, set-up of the solver included, and the cost after each step.
//
//   ceres_eq4 sparse|dense analytic|auto FILE THREADS
//
// Residuals, kernels, start, parametrisation (poses perturbed on the right, `x exp(d)`, d = [rotation, translation]), points eliminated first, damping
// of the first step (1e-4 of the diagonal) and when to stop (a step that lowers the cost by less than 1e-5 of it, 20 steps) are those of the mapping.
// Ceres does not take the step at which it stops, and lists it nowhere but among the linear solves.
#include <ceres/ceres.h>

#include <Eigen/Dense>
#include <cctype>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <string>
#include <vector>

using Eigen::Matrix3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;
template <typename T>
using V3 = Eigen::Matrix<T, 3, 1>;
template <int R, int C>
using Rows = Eigen::Matrix<double, R, C, Eigen::RowMajor>;

static Matrix3d hat(const Vector3d& v) {
  Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

// qx qy qz qw tx ty tz
struct Pose {
  Quaterniond q;
  Vector3d t;
  explicit Pose(const double* p) : q(p[3], p[0], p[1], p[2]), t(p[4], p[5], p[6]) {}
  Vector3d into(const Vector3d& world) const { return q.conjugate() * (world - t); }
};

template <typename T>
V3<T> moved(const T* pose, const V3<T>& p) {
  return Eigen::Map<const Eigen::Quaternion<T>>(pose) * p + Eigen::Map<const V3<T>>(pose + 4);
}

template <typename T>
V3<T> moved_back(const T* pose, const V3<T>& p) {
  return Eigen::Map<const Eigen::Quaternion<T>>(pose).conjugate() * (p - Eigen::Map<const V3<T>>(pose + 4));
}

// x exp(d). Cost functions with analytic Jacobians write those by d into the first six columns, so that nothing is lost on the way through the seven
// stored numbers; automatic ones are by the stored numbers.
class PoseManifold : public ceres::Manifold {
 public:
  explicit PoseManifold(bool analytic) : analytic_(analytic) {}
  int AmbientSize() const override { return 7; }
  int TangentSize() const override { return 6; }
  bool Plus(const double* x, const double* d, double* out) const override {
    const Pose pose(x);
    const Vector3d w(d[0], d[1], d[2]), v(d[3], d[4], d[5]);
    const double t2 = w.squaredNorm(), t = std::sqrt(t2);
    const double half = t < 1e-6 ? 0.5 - t2 / 48 : std::sin(0.5 * t) / t;
    const double a = t < 1e-4 ? 0.5 - t2 / 24 : (1 - std::cos(t)) / t2;
    const double b = t < 1e-4 ? 1.0 / 6 - t2 / 120 : (t - std::sin(t)) / (t2 * t);
    const Quaterniond turn(std::cos(0.5 * t), half * w.x(), half * w.y(), half * w.z());
    const Quaterniond q = (pose.q * turn).normalized();
    const Vector3d wv = w.cross(v);
    const Vector3d p = pose.t + pose.q * (v + a * wv + b * w.cross(wv));
    Eigen::Map<Eigen::Vector4d> rotation(out);
    Eigen::Map<Vector3d> translation(out + 4);
    rotation = q.coeffs();
    translation = p;
    return true;
  }
  bool PlusJacobian(const double* x, double* jacobian) const override {
    Eigen::Map<Rows<7, 6>> j(jacobian);
    j.setZero();
    if (analytic_) {
      j.topRows<6>().setIdentity();
      return true;
    }
    const Pose pose(x);
    const double qx = x[0], qy = x[1], qz = x[2], qw = x[3];
    j.block<4, 3>(0, 0) << qw, -qz, qy, qz, qw, -qx, -qy, qx, qw, -qx, -qy, -qz;
    j.block<4, 3>(0, 0) *= 0.5;
    j.block<3, 3>(4, 3) = pose.q.toRotationMatrix();
    return true;
  }
  bool Minus(const double*, const double*, double*) const override { return false; }
  bool MinusJacobian(const double*, double*) const override { return false; }

 private:
  bool analytic_;
};

// A Jacobian by d, beside a column of zeros.
template <int N>
void put_pose(double* out, const Eigen::Matrix<double, N, 6>& by) {
  Eigen::Map<Rows<N, 7>> j(out);
  j.template leftCols<6>() = by;
  j.col(6).setZero();
}

// Kannala and Brandt 2006, and where the camera sits.
struct Lens {
  double f[2], c[2], k[4], camera_from_rig[7];
  Matrix3d rotation;
  Vector3d translation;
  double slope(double t2) const { return 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3]))); }
  bool folded(double theta) const {
    const double t2 = theta * theta;
    return theta > 100.0 * M_PI / 180.0 || std::fmin(std::fmin(slope(t2), slope(0.75 * t2)), std::fmin(slope(0.5 * t2), slope(0.25 * t2))) <= 0;
  }
};

static double scalar(double x) { return x; }
template <typename T>
double scalar(const T& x) {
  return x.a;
}

struct AutoReprojection {
  const Lens* lens;
  double u, v, sigma;
  template <typename T>
  bool operator()(const T* pose, const T* point, T* r) const {
    const V3<T> in_rig = moved_back(pose, V3<T>(point[0], point[1], point[2]));
    const V3<T> p = lens->rotation.cast<T>() * in_rig + lens->translation.cast<T>();
    const T radius = sqrt(p.x() * p.x() + p.y() * p.y());
    const T theta = atan2(radius, p.z());
    if (lens->folded(scalar(theta))) return false;
    const T t2 = theta * theta;
    const double* k = lens->k;
    const T s = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) / radius;
    r[0] = (lens->f[0] * s * p.x() + lens->c[0] - u) / sigma;
    r[1] = (lens->f[1] * s * p.y() + lens->c[1] - v) / sigma;
    return true;
  }
};

class AnalyticReprojection : public ceres::SizedCostFunction<2, 7, 3> {
 public:
  AnalyticReprojection(const Lens* lens, double u, double v, double sigma) : lens_(lens), u_(u), v_(v), weight_(1 / sigma) {}
  bool Evaluate(double const* const* x, double* r, double** jacobians) const override {
    const Pose pose(x[0]);
    const Vector3d q = pose.into(Eigen::Map<const Vector3d>(x[1]));
    const Vector3d p = lens_->rotation * q + lens_->translation;
    const double radius = std::sqrt(p.x() * p.x() + p.y() * p.y());
    const double theta = std::atan2(radius, p.z()), t2 = theta * theta;
    if (lens_->folded(theta)) return false;
    const double* k = lens_->k;
    const double distorted = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
    const double ux = p.x() / radius, uy = p.y() / radius;
    r[0] = (lens_->f[0] * distorted * ux + lens_->c[0] - u_) * weight_;
    r[1] = (lens_->f[1] * distorted * uy + lens_->c[1] - v_) * weight_;
    if (!jacobians) return true;
    const double by_theta = lens_->slope(t2) / p.squaredNorm();
    const double t = by_theta * p.z(), tz = -by_theta * radius, s = distorted / radius, cross = (t - s) * ux * uy;
    Eigen::Matrix<double, 2, 3> by;
    by << t * ux * ux + s * uy * uy, cross, tz * ux, cross, t * uy * uy + s * ux * ux, tz * uy;
    by.row(0) *= lens_->f[0] * weight_;
    by.row(1) *= lens_->f[1] * weight_;
    const Eigen::Matrix<double, 2, 3> in_rig = by * lens_->rotation;
    if (jacobians[0]) {
      Eigen::Matrix<double, 2, 6> j;
      for (int i = 0; i < 2; ++i) {
        const Vector3d row = in_rig.row(i);
        j.row(i) << row.cross(q).transpose(), -row.transpose();
      }
      put_pose<2>(jacobians[0], j);
    }
    if (jacobians[1]) {
      Eigen::Map<Rows<2, 3>> j(jacobians[1]);
      j = in_rig * pose.q.conjugate().toRotationMatrix();
    }
    return true;
  }

 private:
  const Lens* lens_;
  double u_, v_, weight_;
};

struct AutoPlane {
  Vector3d in_n, in_m, normal;
  double sigma;
  template <typename T>
  bool operator()(const T* m, const T* n, T* r) const {
    const V3<T> p = moved_back(m, moved(n, V3<T>(in_n.cast<T>())));
    r[0] = normal.cast<T>().dot(p - in_m.cast<T>()) / sigma;
    return true;
  }
};

class AnalyticPlane : public ceres::SizedCostFunction<1, 7, 7> {
 public:
  explicit AnalyticPlane(const AutoPlane& plane) : plane_(plane) {}
  bool Evaluate(double const* const* x, double* r, double** jacobians) const override {
    const Pose m(x[0]), n(x[1]);
    const Vector3d p = m.into(n.q * plane_.in_n + n.t), normal = plane_.normal / plane_.sigma;
    r[0] = normal.dot(p - plane_.in_m);
    if (!jacobians) return true;
    Eigen::Matrix<double, 1, 6> j;
    if (jacobians[0]) {
      j << normal.cross(p).transpose(), -normal.transpose();
      put_pose<1>(jacobians[0], j);
    }
    if (jacobians[1]) {
      const Vector3d in_n = n.q.conjugate() * (m.q * normal);
      j << plane_.in_n.cross(in_n).transpose(), in_n.transpose();
      put_pose<1>(jacobians[1], j);
    }
    return true;
  }

 private:
  AutoPlane plane_;
};

struct AutoEdge {
  Vector3d in_n, in_m, direction;
  double sigma;
  template <typename T>
  bool operator()(const T* m, const T* n, T* r) const {
    const V3<T> p = moved_back(m, moved(n, V3<T>(in_n.cast<T>())));
    const V3<T> direction_t = direction.cast<T>();
    Eigen::Map<V3<T>> residual(r);
    residual = direction_t.cross(p - in_m.cast<T>()) / T(sigma);
    return true;
  }
};

class AnalyticEdge : public ceres::SizedCostFunction<3, 7, 7> {
 public:
  explicit AnalyticEdge(const AutoEdge& edge) : edge_(edge), across_(hat(edge.direction / edge.sigma)) {}
  bool Evaluate(double const* const* x, double* r, double** jacobians) const override {
    const Pose m(x[0]), n(x[1]);
    const Vector3d p = m.into(n.q * edge_.in_n + n.t);
    Eigen::Map<Vector3d> residual(r);
    residual = across_ * (p - edge_.in_m);
    if (!jacobians) return true;
    Eigen::Matrix<double, 3, 6> j;
    if (jacobians[0]) {
      j << across_ * hat(p), -across_;
      put_pose<3>(jacobians[0], j);
    }
    if (jacobians[1]) {
      const Matrix3d turned = across_ * (m.q.conjugate() * n.q).toRotationMatrix();
      j << -turned * hat(edge_.in_n), turned;
      put_pose<3>(jacobians[1], j);
    }
    return true;
  }

 private:
  AutoEdge edge_;
  Matrix3d across_;
};

struct AutoStep {
  double measured[7], sigma_rad, sigma_m;
  template <typename T>
  bool operator()(const T* a, const T* b, T* r) const {
    using Q = Eigen::Quaternion<T>;
    const Q qa = Eigen::Map<const Q>(a), qb = Eigen::Map<const Q>(b);
    const Q stated = Quaterniond(measured[3], measured[0], measured[1], measured[2]).cast<T>();
    Q off = stated.conjugate() * (qa.conjugate() * qb);
    if (off.w() < T(0)) off.coeffs() = -off.coeffs();
    const T squared = off.vec().squaredNorm();
    const T sine = squared > T(0) ? sqrt(squared) : T(0);
    const T scale = squared > T(1e-20) ? 2.0 * atan2(sine, off.w()) / sine : 2.0 / off.w();
    const V3<T> t = qa.conjugate() * (Eigen::Map<const V3<T>>(b + 4) - Eigen::Map<const V3<T>>(a + 4));
    for (int i = 0; i < 3; ++i) {
      r[i] = scale * off.vec()[i] / sigma_rad;
      r[3 + i] = (t[i] - measured[4 + i]) / sigma_m;
    }
    return true;
  }
};

class AnalyticStep : public ceres::SizedCostFunction<6, 7, 7> {
 public:
  explicit AnalyticStep(const AutoStep& step) : step_(step) {}
  bool Evaluate(double const* const* x, double* r, double** jacobians) const override {
    step_(x[0], x[1], r);
    if (!jacobians) return true;
    const Pose a(x[0]), b(x[1]);
    const Vector3d w = step_.sigma_rad * Vector3d(r[0], r[1], r[2]), t = a.into(b.t);
    const double t2 = w.squaredNorm(), angle = std::sqrt(t2);
    const double c = angle < 1e-4 ? 1.0 / 12 + t2 / 720 : (1 - 0.5 * angle * std::sin(angle) / (1 - std::cos(angle))) / t2;
    const Matrix3d log_by_turn = Matrix3d::Identity() + 0.5 * hat(w) + c * hat(w) * hat(w);
    const Matrix3d turn = (a.q.conjugate() * b.q).toRotationMatrix();
    Eigen::Matrix<double, 6, 6> j;
    if (jacobians[0]) {
      j << -log_by_turn * turn.transpose() / step_.sigma_rad, Matrix3d::Zero(), hat(t) / step_.sigma_m, -Matrix3d::Identity() / step_.sigma_m;
      put_pose<6>(jacobians[0], j);
    }
    if (jacobians[1]) {
      j << log_by_turn / step_.sigma_rad, Matrix3d::Zero(), Matrix3d::Zero(), turn / step_.sigma_m;
      put_pose<6>(jacobians[1], j);
    }
    return true;
  }

 private:
  AutoStep step_;
};

// Words and numbers of a file, one after the other.
class Reader {
 public:
  explicit Reader(const char* path) {
    FILE* file = std::fopen(path, "rb");
    if (!file) fail("cannot open the file");
    std::fseek(file, 0, SEEK_END);
    text_.resize(std::ftell(file));
    std::rewind(file);
    if (std::fread(text_.data(), 1, text_.size(), file) != text_.size()) fail("cannot read the file");
    std::fclose(file);
    text_.push_back('\0');
    at_ = text_.data();
  }
  void expect(const char* word) {
    while (std::isspace(*at_)) ++at_;
    const size_t length = std::strlen(word);
    if (std::strncmp(at_, word, length)) fail(word);
    at_ += length;
  }
  double number() {
    char* end = nullptr;
    const double value = std::strtod(at_, &end);
    if (end == at_) fail("a number");
    at_ = end;
    return value;
  }
  int index() { return static_cast<int>(number()); }
  void numbers(double* out, int count) {
    for (int i = 0; i < count; ++i) out[i] = number();
  }
  Vector3d vector() {
    Vector3d v;
    numbers(v.data(), 3);
    return v;
  }

 private:
  [[noreturn]] static void fail(const char* what) {
    std::fprintf(stderr, "ceres_eq4: expected %s\n", what);
    std::exit(1);
  }
  std::string text_;
  char* at_;
};

static double now(clockid_t clock) {
  timespec t;
  clock_gettime(clock, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int argc, char** argv) {
  if (argc != 5) return 2;
  const bool dense = !std::strcmp(argv[1], "dense"), analytic = !std::strcmp(argv[2], "analytic");
  Reader in(argv[3]);
  in.expect("lenses");
  std::vector<Lens> lenses(in.index());
  for (Lens& lens : lenses) {
    in.expect("kannala-brandt");
    in.numbers(lens.f, 2);
    in.numbers(lens.c, 2);
    in.numbers(lens.k, 4);
    in.numbers(lens.camera_from_rig, 7);
    const Pose pose(lens.camera_from_rig);
    lens.rotation = pose.q.toRotationMatrix();
    lens.translation = pose.t;
  }
  in.expect("poses");
  const int pose_count = in.index();
  std::vector<double> poses(7 * pose_count);
  in.numbers(poses.data(), 7 * pose_count);
  in.expect("points");
  const int point_count = in.index();
  std::vector<double> points(3 * point_count);
  in.numbers(points.data(), 3 * point_count);

  PoseManifold manifold(analytic);
  ceres::Problem::Options shared;
  shared.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  shared.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem problem(shared);
  for (int i = 0; i < pose_count; ++i) problem.AddParameterBlock(&poses[7 * i], 7, &manifold);
  if (pose_count > 0) problem.SetParameterBlockConstant(&poses[0]);

  in.expect("observations");
  const int observations = in.index();
  const double sigma_px = in.number();
  ceres::HuberLoss huber(in.number());
  for (int i = 0; i < observations; ++i) {
    const int point = in.index(), pose = in.index();
    const Lens* lens = &lenses.at(in.index());
    const double u = in.number(), v = in.number();
    ceres::CostFunction* cost = nullptr;
    if (analytic) {
      cost = new AnalyticReprojection(lens, u, v, sigma_px);
    } else {
      cost = new ceres::AutoDiffCostFunction<AutoReprojection, 2, 7, 3>(new AutoReprojection{lens, u, v, sigma_px});
    }
    problem.AddResidualBlock(cost, &huber, &poses[7 * pose], &points[3 * point]);
  }
  in.expect("planes");
  const int planes = in.index();
  const double plane_sigma = in.number();
  ceres::CauchyLoss plane_loss(in.number());
  for (int i = 0; i < planes; ++i) {
    const int m = in.index(), n = in.index();
    AutoPlane plane;
    plane.in_n = in.vector();
    plane.in_m = in.vector();
    plane.normal = in.vector();
    plane.sigma = plane_sigma;
    ceres::CostFunction* cost = nullptr;
    if (analytic) {
      cost = new AnalyticPlane(plane);
    } else {
      cost = new ceres::AutoDiffCostFunction<AutoPlane, 1, 7, 7>(new AutoPlane(plane));
    }
    problem.AddResidualBlock(cost, &plane_loss, &poses[7 * m], &poses[7 * n]);
  }
  in.expect("edges");
  const int edges = in.index();
  const double edge_sigma = in.number();
  ceres::CauchyLoss edge_loss(in.number());
  for (int i = 0; i < edges; ++i) {
    const int m = in.index(), n = in.index();
    AutoEdge edge;
    edge.in_n = in.vector();
    edge.in_m = in.vector();
    edge.direction = in.vector();
    edge.sigma = edge_sigma;
    ceres::CostFunction* cost = nullptr;
    if (analytic) {
      cost = new AnalyticEdge(edge);
    } else {
      cost = new ceres::AutoDiffCostFunction<AutoEdge, 3, 7, 7>(new AutoEdge(edge));
    }
    problem.AddResidualBlock(cost, &edge_loss, &poses[7 * m], &poses[7 * n]);
  }
  in.expect("steps");
  const int steps = in.index();
  for (int i = 0; i < steps; ++i) {
    const int a = in.index(), b = in.index();
    AutoStep step;
    in.numbers(step.measured, 7);
    step.sigma_rad = in.number();
    step.sigma_m = in.number();
    ceres::CostFunction* cost = nullptr;
    if (analytic) {
      cost = new AnalyticStep(step);
    } else {
      cost = new ceres::AutoDiffCostFunction<AutoStep, 6, 7, 7>(new AutoStep(step));
    }
    problem.AddResidualBlock(cost, nullptr, &poses[7 * a], &poses[7 * b]);
  }

  ceres::Solver::Options options;
  options.linear_solver_type = dense ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
  options.num_threads = std::atoi(argv[4]);
  options.max_num_iterations = 20;
  options.function_tolerance = 1e-5;
  options.gradient_tolerance = 0;
  options.parameter_tolerance = 0;
  options.initial_trust_region_radius = 1e4;
  options.logging_type = ceres::SILENT;
  auto* ordering = new ceres::ParameterBlockOrdering;
  for (int p = 0; p < point_count; ++p)
    if (problem.HasParameterBlock(&points[3 * p])) ordering->AddElementToGroup(&points[3 * p], 0);
  for (int c = 0; c < pose_count; ++c) ordering->AddElementToGroup(&poses[7 * c], 1);
  options.linear_solver_ordering.reset(ordering);

  const double cpu = now(CLOCK_PROCESS_CPUTIME_ID), wall = now(CLOCK_MONOTONIC);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  const double cpu_s = now(CLOCK_PROCESS_CPUTIME_ID) - cpu, wall_s = now(CLOCK_MONOTONIC) - wall;
  std::printf("ceres %s %s, %s threads: %d residuals, cost %.9f -> %.9f, %d linear solves, cpu %.3f s, wall %.3f s\n", argv[1], argv[2], argv[4],
              observations + planes + edges + steps, summary.initial_cost, summary.final_cost, summary.num_linear_solves, cpu_s, wall_s);
  for (const auto& step : summary.iterations)
    if (step.iteration > 0)
      std::printf("  step %d: cost %.9f after %.3f s%s\n", step.iteration, step.cost,
                  step.cumulative_time_in_seconds + summary.preprocessor_time_in_seconds, step.step_is_successful ? "" : ", refused");
  return summary.IsSolutionUsable() ? 0 : 1;
}
