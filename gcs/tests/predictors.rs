//! Every predictor of the world model flies: observer, belief and receding horizon.

use std::sync::Arc;

use crpl_gcs::lab;
use crpl_gcs::station::Station;
use crpl_gcs::station::models::Models;
use crpl_gcs::station::pilot::Controller;
use crpl_model::encoder::BuiltIn;
use crpl_model::predictor::{Networks, PredictorKind};
use crpl_model::world_model::WorldModel;
use crpl_sitl::{Scenario, Sim};

fn flown(kind: PredictorKind, controller: Controller) -> Station {
    let networks = Networks::built_in(BuiltIn::Centroid).expect("the shipped networks read");
    let world = WorldModel::built_in(BuiltIn::Centroid).expect("the shipped checkpoint reads");
    let world = world.with_predictor(kind, &networks).expect("they belong together");
    let models =
        Models { world: Arc::new(world), ..Models::load(None, None).expect("the shipped models read") };
    let scenario = Scenario::default();
    let mut station = models.station(controller, &scenario).expect("the shipped policies fit");
    lab::fly(&mut Sim::new(scenario.clone(), 2), &mut station, scenario.horizon);
    station
}

#[test]
fn each_predictor_flies_crpl_and_crpl_rh_to_the_goal_and_again_the_same_way() {
    for controller in [Controller::Crpl, Controller::CrplRh] {
        for kind in PredictorKind::ALL {
            let station = flown(kind, controller);
            let last = station.records().last().expect("it flew");
            let off = (last.r_next - Scenario::default().goal).norm();
            assert!(off < 0.1, "{controller} with {kind:?} ends {off} from the goal");
            if controller == Controller::CrplRh && kind == PredictorKind::Mlp {
                assert_eq!(flown(kind, controller).records(), station.records());
            }
        }
    }
}
